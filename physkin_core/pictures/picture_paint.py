"""Paints stitches onto a picture after light is traced, as they are too fine for light paths.

Each pixel of a painted surface that is seen where the picture has cloth takes the paint's colour in the cloth's light.
Dimensions: `h`, `w` height and width of the picture [pixels], `q` pairs of a face and a pixel.
"""

from __future__ import annotations

import numpy as np

from physkin_core.mesh.surfaces import Surface
from physkin_core.mesh.tiles_seen import colours_seen
from physkin_core.pictures.picture_scene import Mesh, View

__all__ = ["painted"]

LIES_ON = 0.006
"""[m] from where the picture has a surface: paint that far from it is hidden."""
DARKEST = 0.03
"""Reflectance: light on darker cloth is taken for that on this, as its gloss is no light on the paint."""


def painted(
    radiance: np.ndarray,
    albedo: np.ndarray,
    positions: np.ndarray,
    view: View,
    mesh: Mesh,
    *,
    gain: float,
) -> np.ndarray:
    """A picture's radiance (h, w, 3) with a mesh's material on it, as far as that is opaque. albedo, positions: (h, w,
    3) of what is seen. gain: from the material's colour to reflectance."""
    light = radiance.mean(axis=-1, keepdims=True) / np.maximum(albedo.mean(axis=-1, keepdims=True), DARKEST)
    face, row, column, shares = _covered(mesh.vertices, mesh.faces, view)
    corners = mesh.faces[face]
    point, facing = (np.einsum("qc,qcx->qx", shares, each[corners]) for each in (mesh.vertices, mesh.vertex_normals))
    seen = np.linalg.norm(point - positions[row, column], axis=1) < max(LIES_ON, 2 * view.pixel)
    seen &= ((view.origin - point) * facing).sum(axis=1) > 0
    face, row, column, shares = face[seen], row[seen], column[seen], shares[seen]
    colour = _looked_up(mesh.surface, np.einsum("qc,qcx->qx", shares, mesh.places[face]), view.pixel)
    opacity, paint = colour[:, 3:], gain * colour[:, :3] * light[row, column]
    found = radiance.copy()
    found[row, column] = radiance[row, column] * (1 - opacity) + paint * opacity
    return found


def _covered(
    vertices: np.ndarray, faces: np.ndarray, view: View
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Faces and the pixels whose middles they cover: face, row and column (q,), and shares (q, 3) of its corners."""
    pixels, away = view.pixels(vertices)
    corners = pixels[faces]
    low = np.clip(np.floor(corners.min(axis=1)), 0, view.size).astype(int)
    high = np.clip(np.ceil(corners.max(axis=1)), 0, view.size).astype(int)
    across, down = (high - low).T
    count = across * down
    face = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    column = low[face, 0] + within % np.maximum(across, 1)[face]
    row = low[face, 1] + within // np.maximum(across, 1)[face]
    middle = np.stack([column + 0.5, row + 0.5], axis=1)
    a, b, c = np.moveaxis(corners[face], 1, 0)
    flat = np.stack([_doubled(b, c, middle), _doubled(c, a, middle), _doubled(a, b, middle)], axis=1)
    total = flat.sum(axis=1, keepdims=True)
    inside = ((flat * np.sign(total)) >= 0).all(axis=1) & (np.abs(total[:, 0]) > 1e-9)
    face, flat = face[inside], flat[inside] / total[inside]
    shares = flat / away[faces[face]]  # as seen in perspective
    return face, row[inside], column[inside], shares / shares.sum(axis=1, keepdims=True)


def _doubled(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the area of triangles of points (q, 2), with its sign."""
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def _looked_up(surface: Surface, places: np.ndarray, pixel: float) -> np.ndarray:
    """(q, 4) colour and opacity of the material's picture at places (q, 2), between its four pixels there."""
    from scipy.ndimage import map_coordinates

    image = colours_seen(surface.picture, surface.repeats, pixel)
    height, width = image.shape[:2]
    x = places[:, 0] * surface.repeats[0] * width - 0.5
    y = (1 - places[:, 1] * surface.repeats[1]) * height - 0.5
    channels = np.moveaxis(image, -1, 0)
    return np.stack([map_coordinates(each, [y, x], order=1, mode="grid-wrap") for each in channels], axis=1)
