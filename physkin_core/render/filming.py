"""A dressed avatar in pictures: filmed as it moves through the world, or frames of it beside each other in a strip.

Dimensions: `T` frames. Metres; world with Z up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import Avatar
from physkin_core.look.avatar_look import avatar_colours
from physkin_core.look.cloth_look import cloth_colours, cloth_look, seen_from_afar
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import surfaces_of
from physkin_core.model.garment import vertex_normals
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.pictures.picture import BODY_COLOUR, Mesh, contact_sheet, render
from physkin_core.progress import Watch

__all__ = [
    "MOST_FRAMES",
    "Camera",
    "avatar_mesh",
    "cloth_meshes",
    "draw_figures",
    "draw_strip",
    "dressed_meshes",
    "film",
]

MOST_FRAMES = 24
FRAME_SIZE = 180, 320
"""Of a frame in a strip, width and height [pixels]."""
VIEWS = 15.0, 195.0
"""Azimuths [degrees] of a strip's two rows."""
AROUND = 0.05
"""[m] Room about the body."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Where it stands and what it takes.

    azimuth: [degrees] as of `picture.render`, in the world: 0 looks at a body that faces X from the front, 90 from its
    left; as near as all that is filmed fits. follow: go with the root over the floor, else stand still. size: w, h
    [pixels]. samples: light paths a pixel.
    """

    azimuth: float = 30.0
    follow: bool = True
    size: tuple[int, int] = (480, 600)
    samples: int = 8


def film(outfit: Outfit, motion: Motion, camera: Camera, *, watch: Watch = lambda share: None) -> Iterator[np.ndarray]:
    """Pictures (h, w, 3) uint8 of each frame. watch: told how much is drawn.

    Cloth sways as `Outfit.sway` says. Everything is draped twice, which takes little beside drawing: first to see how
    much room it needs. The floor is where the lowest vertex of all frames is. Raises PictureError as `picture.render`
    does.
    """
    places = motion.root_position * [1, 1, 0] if camera.follow else np.zeros((motion.frame_count, 3))
    corners = []
    for place, meshes in zip(places, _frames(outfit, motion)):
        points = np.concatenate([mesh.vertices for mesh in meshes])
        corners.append([points.min(axis=0) - place, points.max(axis=0) - place])
    lows, highs = np.moveaxis(np.array(corners), 1, 0)
    bounds = np.stack([lows.min(axis=0), highs.max(axis=0)])
    for frame, (place, meshes) in enumerate(zip(places, _frames(outfit, motion))):
        watch(frame / motion.frame_count)
        yield render(
            meshes,
            size=camera.size,
            azimuth=camera.azimuth,
            bounds=bounds + place,
            floor=float(bounds[0, 2]),
            samples=camera.samples,
        )
    watch(1.0)


def _frames(outfit: Outfit, motion: Motion) -> Iterator[list[Mesh]]:
    """Body and garments of each frame, in the world."""
    turns = Rotation.from_quat(motion.root_orientation)
    positions = motion.positions_for(outfit.rig)
    outfit.reset()
    for pose, time, root, turn, place in zip(positions, motion.times, motion.root, turns, motion.root_position):
        clouds = outfit.drape(pose, time=time, root=root)
        body, *cloth = (turn.apply(cloud[:, :3]) + place for cloud in (outfit.posed_body(pose), *clouds))
        yield dressed_meshes(outfit, body, cloth)


def dressed_meshes(outfit: Outfit, body: np.ndarray, cloth: Sequence[np.ndarray]) -> list[Mesh]:
    """Surfaces of one frame. body: (V, 3) vertices of `body_to_draw`; cloth: (v, 3 or more) of each garment, positions
    first; all [m] in one frame with Z up."""
    shown = outfit.faces_to_draw if len(cloth) > 1 else slice(None)
    skin = avatar_mesh(outfit.body_to_draw, body, shown)
    worn: list[Mesh] = []
    for cloud, layer, colour in zip(cloth, outfit.layers, cloth_colours(outfit.garments)):
        points, garment = np.asarray(cloud)[:, :3], layer.model
        look = cloth_look(garment.garment, garment.fabric, layer.face_visible, colour)
        if look is None:
            worn.append(Mesh(points, layer.faces, seen_from_afar(garment.fabric, colour)))
        else:
            worn += cloth_meshes(look, points, layer.faces)
    return [skin, *worn]


def cloth_meshes(look: Look, points: np.ndarray, faces: np.ndarray) -> list[Mesh]:
    """A garment as its fabric looks, with stitches and hems. points: (v, 3) [m]. faces: (f, 3) of these."""
    (cloth,) = surfaces_of(look, "cloth", (1.0, 1.0, 1.0), len(faces))
    normals = vertex_normals(points, faces)
    found = [Mesh(points, faces, surface=cloth, places=look.uv, normals=normals)]
    for finish, surface in look.finishes:
        own = normals[finish.vertices] if surface.blended else None
        placed = finish.placed(points, normals)
        found.append(Mesh(placed, finish.faces, surface=surface, places=finish.places, normals=own))
    return found


def avatar_mesh(avatar: Avatar, vertices: np.ndarray, shown: np.ndarray | slice = slice(None)) -> Mesh:
    """An avatar, or some of its faces, in its own colours. vertices: (V, 3) [m] where they are."""
    colours = avatar_colours(avatar)
    return Mesh(vertices, avatar.faces[shown], BODY_COLOUR if colours is None else colours[shown])


def draw_strip(outfit: Outfit, motion: Motion, count: int, *, watch: Watch = lambda share: None) -> np.ndarray:
    """Frames evenly spread over a motion, the first and the last among them, from the front and below it from the back.

    Every frame of the motion is draped, as order is kept from one to the next. watch: told how far the drawing is.
    Returns (H, W, 3) uint8. Raises ValueError for a count below 2, above 24 or above what the motion has; PictureError
    as `render` does.
    """
    most = min(MOST_FRAMES, motion.frame_count)
    if not 2 <= count <= most:
        raise ValueError(f"a strip of motion {motion.name!r} has 2 to {most} frames, got {count}")
    chosen = set(np.linspace(0, motion.frame_count - 1, count).round().astype(int).tolist())
    columns = []
    for frame, (positions, gravity) in enumerate(zip(motion.positions_for(outfit.rig), motion.gravity)):
        cloth = outfit.drape(positions, gravity)
        if frame in chosen:
            columns.append(dressed_meshes(outfit, outfit.posed_body(positions), cloth))
    return draw_figures(columns, size=FRAME_SIZE, watch=watch)


def draw_figures(
    figures: Sequence[Sequence[Mesh]],
    *,
    size: tuple[int, int],
    watch: Watch = lambda share: None,
) -> np.ndarray:
    """Figures beside each other, from the front and below it from the back: (H, W, 3) uint8. figures: of each its body,
    then what it wears, as of `dressed_meshes`. size: of one, width and height [pixels]. watch, PictureError: as of
    `draw_strip`."""
    half = max(np.abs(body.vertices - _middle(body.vertices)).max() for body, *_ in figures) + AROUND
    pictures = []
    for azimuth in VIEWS:
        for meshes in figures:
            bounds = _middle(meshes[0].vertices) + _box(half, size)
            pictures.append(render(meshes, size=size, azimuth=azimuth, bounds=bounds, samples=8))
            watch(len(pictures) / (len(VIEWS) * len(figures)))
    return contact_sheet(pictures, columns=len(figures), gap=2)


def _middle(body: np.ndarray) -> np.ndarray:
    return (body.min(axis=0) + body.max(axis=0)) / 2


def _box(half: float, size: tuple[int, int]) -> np.ndarray:
    """(2, 3) [m] about the origin, as wide as a picture of that size is for its height."""
    across = half * size[0] / size[1]
    return np.array([[-across, -across, -half], [across, across, half]])
