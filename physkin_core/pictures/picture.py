"""Still pictures of bodies and garments: a light studio with one soft lamp, rendered on the CPU (extra `[view]`).

The floor's brightness is chosen to equal the background's, so that the ground has shadows but no horizon.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from physkin_core.extras import install_command
from physkin_core.pictures.picture_paint import painted
from physkin_core.pictures.picture_scene import BODY_COLOUR, Mesh, drawn_mesh, light, to_linear, view_of

__all__ = [
    "BODY_COLOUR",
    "CLOTH_COLOUR",
    "Mesh",
    "PictureError",
    "contact_sheet",
    "layer_colours",
    "pillow",
    "render",
    "save_png",
]

log = logging.getLogger(__name__)

CLOTH_COLOUR = (0.16, 0.42, 0.58)
LAYER_COLOURS = ((0.25, 0.28, 0.33), (0.75, 0.35, 0.25), CLOTH_COLOUR, (0.55, 0.52, 0.30))
"""Of the garments of an outfit, from the skin outwards."""

BACKGROUND = 0.96  # sRGB grey
TEXT_COLOUR = (70, 74, 80)
UPRIGHT_GAIN = 1.4  # an upright surface gets less light than the floor
FLOOR_RADIUS = 40.0  # [m]
BLANK_FROM = 5.0  # times the meshes' own reach
GUIDE_SAMPLES = 4  # a pixel, for colours, normals and positions


class PictureError(RuntimeError):
    """Pictures cannot be made here; the message says what to install."""


def layer_colours(count: int) -> tuple[tuple[float, float, float], ...]:
    """Of so many garments worn over each other, from the skin outwards; of one its usual colour."""
    return LAYER_COLOURS[:count] if count > 1 else (CLOTH_COLOUR,)


def render(
    meshes: Sequence[Mesh],
    *,
    size: tuple[int, int] = (400, 500),
    azimuth: float = 30.0,
    elevation: float = 8.0,
    distance: float | None = None,
    bounds: np.ndarray | None = None,
    floor: float | Literal["lowest"] | None = "lowest",
    samples: int = 16,
) -> np.ndarray:
    """Draw meshes from a camera that looks at their bounding box.

    size: width, height [pixels]. azimuth, elevation: where the camera stands [degrees]; 0, 0 is on X, in front of the
    body, a positive azimuth towards Y. bounds: (2, 3) [m] box to fit into the picture, default the meshes' own (give it
    to keep the camera still between frames). distance: [m] from its middle, default as near as all of it fits. floor:
    its height [m]; "lowest": the lowest vertex; None: no floor. samples: light paths a pixel. Returns (height, width,
    3) uint8 sRGB.
    Raises PictureError when mitsuba is not installed, ValueError for meshes that cannot be drawn.
    """
    mi = _mitsuba()
    if not meshes:
        raise ValueError("nothing to draw: give at least one mesh")
    points = np.concatenate([_checked(mesh) for mesh in meshes])
    bounds = np.stack([points.min(axis=0), points.max(axis=0)]) if bounds is None else np.asarray(bounds, dtype=float)
    if floor == "lowest":
        floor = float(points[:, 2].min())
    emitters, lit = light(mi, azimuth)
    view, gain = view_of(bounds, size, azimuth, elevation, distance), UPRIGHT_GAIN / lit
    paints = [mesh for mesh in meshes if mesh.surface is not None and mesh.surface.blended]
    solid = [mesh for mesh in meshes if mesh.surface is None or not mesh.surface.blended]
    scene = {
        "type": "scene",
        "sensor": view.camera(mi),
        **emitters,
        **{f"mesh{index}": drawn_mesh(mi, mesh, gain=gain, pixel=view.pixel) for index, mesh in enumerate(solid)},
    }
    if floor is not None:
        placed = mi.ScalarTransform4f().translate([0, 0, floor]).scale(FLOOR_RADIUS)
        grey = {"type": "rgb", "value": 1 / lit}
        scene["floor"] = {"type": "disk", "to_world": placed, "bsdf": {"type": "diffuse", "reflectance": grey}}
    scene = mi.load_dict(scene)
    paths = {"type": "path", "max_depth": 4, "hide_emitters": True}
    radiance, cover = np.split(_layers(mi, scene, samples, paths), [3], axis=-1)
    guides = {"type": "aov", "aovs": "albedo:albedo,normal:sh_normal,position:position"}
    albedo, normals, positions = np.split(_layers(mi, scene, GUIDE_SAMPLES, guides), 3, axis=-1)
    lighted = _denoised(radiance, albedo, normals)
    for mesh in paints:
        lighted = painted(lighted, albedo, positions, view, mesh, gain=gain)
    picture = lighted + (1 - cover)
    reach = np.linalg.norm(points - bounds.mean(axis=0), axis=1).max()
    away = np.linalg.norm(positions - bounds.mean(axis=0), axis=-1, keepdims=True) / reach
    away[~normals.any(axis=-1)] = np.inf  # the sky
    plain = np.abs(albedo - normals[..., 2:] / lit).max(axis=-1, keepdims=True) < 0.01  # floor, sky and their horizon
    blank = plain * np.clip((away - BLANK_FROM) / 2, 0.0, 1.0)  # so far from the meshes that no shadow falls
    return _to_srgb(picture * (1 - blank) + blank)


def contact_sheet(
    images: Sequence[np.ndarray], *, columns: int, captions: Sequence[str] | None = None, gap: int = 8
) -> np.ndarray:
    """Lay pictures of one size (h, w, 3) uint8 out in rows of `columns`, a caption under each. Returns (H, W, 3) uint8.

    Raises ValueError when sizes or the number of captions differ, PictureError when pillow is not installed.
    """
    if not images or columns < 1:
        raise ValueError(f"a sheet needs at least one picture and one column, got {len(images)} and {columns}")
    sizes = {np.asarray(image).shape for image in images}
    if len(sizes) > 1:
        raise ValueError(f"pictures of one sheet must have one size, got {sorted(sizes)}")
    if captions is not None and len(captions) != len(images):
        raise ValueError(f"{len(images)} pictures but {len(captions)} captions")
    height, width, _ = sizes.pop()
    text_height = max(12, width // 18)
    line = 0 if captions is None else 2 * text_height
    rows = -(-len(images) // columns)
    paper = round(255 * BACKGROUND)
    sheet = np.full((rows * (height + line + gap) + gap, columns * (width + gap) + gap, 3), paper, dtype=np.uint8)
    cells = [divmod(k, columns) for k in range(len(images))]
    places = [(gap + row * (height + line + gap), gap + column * (width + gap)) for row, column in cells]
    for (top, left), image in zip(places, images, strict=True):
        sheet[top : top + height, left : left + width] = image
    if captions is None:
        return sheet
    pil = pillow()
    drawn = pil.Image.fromarray(sheet)
    pen, font = pil.ImageDraw.Draw(drawn), pil.ImageFont.load_default(text_height)
    for (top, left), caption in zip(places, captions, strict=True):
        pen.text((left + width / 2, top + height + line / 2), caption, fill=TEXT_COLOUR, font=font, anchor="mm")
    return np.array(drawn)


def save_png(path: str | Path, image: np.ndarray) -> None:
    """Write a picture (h, w, 3) uint8 to a PNG file. Raises PictureError when pillow is not installed."""
    pillow().Image.fromarray(np.asarray(image, dtype=np.uint8)).save(path, format="PNG", optimize=True)


def _checked(mesh: Mesh) -> np.ndarray:
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise ValueError(f"a mesh needs vertices (n, 3) and faces (f, 3), got {vertices.shape} and {faces.shape}")
    if np.shape(mesh.colour) not in ((3,), faces.shape):
        raise ValueError(f"a mesh needs one colour (3,) or one a face {faces.shape}, got {np.shape(mesh.colour)}")
    if not np.isfinite(vertices).all():
        raise ValueError("a mesh to draw has vertices that are not finite")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"face indices go from {faces.min()} to {faces.max()}; the mesh has {len(vertices)} vertices")
    return vertices


def _layers(mi, scene, samples: int, integrator: dict) -> np.ndarray:
    return np.array(mi.render(scene, integrator=mi.load_dict(integrator), spp=samples), dtype=np.float32)


def _denoised(light: np.ndarray, albedo: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Take the grain out of `light` (h, w, 3) by Open Image Denoise, guided by albedo and normals (h, w, 3)."""
    try:
        import pyoidn
    except ImportError:  # there is none for Linux on ARM
        _tell_grainy()
        return light
    return pyoidn.denoise(light, np.ascontiguousarray(albedo), np.ascontiguousarray(normals), hdr=True)


@cache  # once is enough
def _tell_grainy() -> None:
    log.warning("pictures are grainy without pyoidn: %s", install_command("view"))


def _to_srgb(radiance: np.ndarray) -> np.ndarray:
    linear = np.clip(radiance * to_linear(BACKGROUND), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255 * encoded).astype(np.uint8)


def _mitsuba():
    try:
        import mitsuba
    except ImportError as error:
        raise PictureError(f"pictures need mitsuba: {install_command('view')}") from error
    mitsuba.set_variant("scalar_rgb")  # the one that needs neither a GPU nor LLVM
    return mitsuba


def pillow():
    """The package `PIL` with what is used of it. Raises PictureError when pillow is not installed."""
    try:
        import PIL.Image
        import PIL.ImageDraw
        import PIL.ImageFont
    except ImportError as error:
        raise PictureError(f"pictures need pillow: {install_command('view')}") from error
    return PIL
