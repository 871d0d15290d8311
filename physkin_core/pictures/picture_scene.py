"""The scene of a picture as mitsuba has it: surfaces in their colours or materials, a camera, a studio's light.

Dimensions: `n` vertices and `f` faces of a surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import Surface, split_at_seams
from physkin_core.mesh.tiles_seen import colours_seen, normals_seen
from physkin_core.model.garment import vertex_normals

__all__ = ["BODY_COLOUR", "Mesh", "View", "drawn_mesh", "light", "to_linear", "view_of"]

BODY_COLOUR = (0.80, 0.70, 0.63)
FIELD_OF_VIEW = 20.0  # [degrees] from the lower to the upper edge
MARGIN = 1.06
LAMP_DIRECTION = (0.5, 0.6, 1.0)  # relative to a camera on X
LAMP_STRENGTH = 1.3  # light it throws on the floor; the sky throws 1
LAMP_RADIUS = 9.0  # [degrees] softness of shadows
LAMP_DISTANCE = 5000.0  # [m]
FACE_COLOUR = "face_color"  # mitsuba's name for an attribute of faces
INSIDE = 0.8  # of the light that cloth has outside


@dataclass(frozen=True)
class Mesh:
    """A surface to draw: vertices (n, 3) [m], Z up; faces (f, 3) vertex indices; colour (3,) sRGB in [0, 1], or (f, 3)
    of each face. surface, places: its material, drawn in place of the colour where it has a picture, and where in that
    the faces' corners are (f, 3, 2) [m]. normals: (n, 3) then, None for the mesh's own."""

    vertices: np.ndarray
    faces: np.ndarray
    colour: tuple[float, float, float] | np.ndarray = BODY_COLOUR
    surface: Surface | None = None
    places: np.ndarray | None = None
    normals: np.ndarray | None = None

    @property
    def vertex_normals(self) -> np.ndarray:
        """(n, 3) unit normals."""
        return vertex_normals(self.vertices, self.faces) if self.normals is None else self.normals


@dataclass(frozen=True)
class View:
    """Where a picture is taken from. size: its width and height [pixels]. origin, target: (3,) [m]. right, up, back:
    (3,) unit vectors."""

    size: tuple[int, int]
    origin: np.ndarray
    target: np.ndarray
    right: np.ndarray
    up: np.ndarray
    back: np.ndarray

    @property
    def pixel(self) -> float:
        """[m] Its size at the target."""
        return 2 * np.linalg.norm(self.target - self.origin) * self._slope / self.size[1]

    def pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows (n, 2) of points (n, 3), and how far before the camera they are (n,)."""
        apart = points - self.origin
        away = -apart @ self.back
        scale = self.size[1] / (2 * self._slope * away)
        x, y = apart @ self.right * scale, apart @ self.up * scale
        return np.stack([self.size[0] / 2 + x, self.size[1] / 2 - y], axis=-1), away

    def camera(self, mi) -> dict:
        """Perspective, for mitsuba."""
        width, height = self.size
        to_world = mi.ScalarTransform4f().look_at(
            origin=self.origin.tolist(), target=self.target.tolist(), up=[0, 0, 1]
        )
        return {
            "type": "perspective",
            "fov": FIELD_OF_VIEW,
            "fov_axis": "y",
            "to_world": to_world,
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgba",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": 16},
        }

    @property
    def _slope(self) -> float:
        """Of the picture's upper edge."""
        return math.tan(math.radians(FIELD_OF_VIEW) / 2)


def to_linear(colour: float | np.ndarray) -> np.ndarray:
    """Linear light of sRGB, both in [0, 1]."""
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def view_of(
    bounds: np.ndarray, size: tuple[int, int], azimuth: float, elevation: float, distance: float | None
) -> View:
    """Of the middle of a box (2, 3), without a distance from as near as all of it fits."""
    a, e = math.radians(azimuth), math.radians(elevation)
    back = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    up = np.cross(back, right)
    width, height = size
    slope = math.tan(math.radians(FIELD_OF_VIEW) / 2) / MARGIN
    corners = np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    centre = bounds.mean(axis=0)
    x, y, depth = ((corners - centre) @ axis for axis in (right, up, back))
    if distance is None:
        distance = (depth + np.maximum(np.abs(y) / slope, np.abs(x) / (slope * width / height))).max()
    return View(size, centre + distance * back, centre, right, up, back)


def drawn_mesh(mi, mesh: Mesh, *, gain: float, pixel: float):
    """A mitsuba mesh in its material, in its colours where that has no picture. gain: from these to reflectance: it is
    shown in about its own where it stands upright. pixel: of the picture [m] where the mesh is."""
    if textured := mesh.surface is not None and mesh.surface.picture is not None:
        own, places, faces = split_at_seams(Look.with_places(mesh.places), mesh.faces)
        material = _cloth(mi, mesh.surface, gain, pixel)
    else:
        own, faces = np.unique(mesh.faces, return_inverse=True)  # vertices without a face would have no normal
        reflectance = np.float32(gain * to_linear(np.array(mesh.colour, dtype=np.float32)))
        shown = {"type": "rgb", "value": reflectance.tolist()}
        if reflectance.ndim == 2:
            shown = {"type": "mesh_attribute", "name": FACE_COLOUR}
        material = {"side": {"type": "principled", "base_color": shown, "roughness": 0.7, "specular": 0.25}}
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", **material})
    layout = {"has_vertex_normals": True, "has_vertex_texcoords": textured}
    drawn = mi.Mesh("mesh", len(own), len(mesh.faces), properties, **layout)
    if not textured and reflectance.ndim == 2:
        drawn.add_attribute(FACE_COLOUR, 3, reflectance.ravel())
    buffers = mi.traverse(drawn)
    buffers["vertex_positions"] = np.ascontiguousarray(mesh.vertices[own], dtype=np.float32).ravel()
    buffers["faces"] = faces.astype(np.uint32).ravel()
    if textured:
        buffers["vertex_texcoords"] = places.astype(np.float32).ravel()
    buffers.update()  # computes the vertex normals, which are open at seams
    if textured:
        buffers["vertex_normals"] = mesh.vertex_normals[own].astype(np.float32).ravel()
        buffers.update()
    return drawn


def _cloth(mi, surface: Surface, gain: float, pixel: float) -> dict[str, dict]:
    """Both sides of cloth."""
    base = gain * np.float32(surface.colour) * colours_seen(surface.picture, surface.repeats, pixel)[..., :3]
    sides = {}
    for side, share in (("outside", 1.0), ("inside", INSIDE)):
        found = {"type": "principled", "base_color": _bitmap(mi, share * base, surface.repeats), "specular": 0.25}
        found |= {"roughness": surface.roughness, "sheen": surface.sheen}
        if surface.normals is not None:
            tile = normals_seen(surface.normals, surface.normal_repeats, pixel)
            found = {"type": "normalmap", "normalmap": _bitmap(mi, tile, surface.normal_repeats), "bsdf": found}
        sides[side] = found
    return sides


def _bitmap(mi, image: np.ndarray, repeats: tuple[float, float]) -> dict:
    """A texture of linear values, the upper row last."""
    upright = np.ascontiguousarray(image[::-1], dtype=np.float32)
    place = mi.ScalarTransform3f().scale([*repeats])
    return {"type": "bitmap", "bitmap": mi.Bitmap(upright), "raw": True, "to_uv": place}


def light(mi, azimuth: float) -> tuple[dict, float]:
    """Brightness 1 from all around and a soft lamp that stays beside the camera.

    Returns the emitters and how much light falls on a floor, relative to brightness 1 from everywhere.
    """
    turn = math.radians(azimuth)
    x, y, z = np.array(LAMP_DIRECTION) / np.linalg.norm(LAMP_DIRECTION)
    place = LAMP_DISTANCE * np.array(
        [x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), z]
    )
    spread = math.tan(math.radians(LAMP_RADIUS))
    share = z * spread**2 / (1 + spread**2)  # of the floor's sky that the lamp hides
    facing = mi.ScalarTransform4f().look_at(origin=place.tolist(), target=[0, 0, 0], up=[0, 0, 1])
    glow = {"type": "area", "radiance": {"type": "rgb", "value": float(1 + LAMP_STRENGTH / share)}}
    lamp = {"type": "disk", "to_world": facing.scale(LAMP_DISTANCE * spread), "emitter": glow}
    return {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}, "lamp": lamp}, 1 + LAMP_STRENGTH
