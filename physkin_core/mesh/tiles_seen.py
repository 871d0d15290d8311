"""A material's repeating pictures as a drawing can show them: no finer than its pixels, so that nothing shimmers.

Dimensions: `h`, `w` height and width of what is seen [pixels].
"""

from __future__ import annotations

import io
from functools import lru_cache

import numpy as np

from physkin_core.mesh.surfaces import Picture

__all__ = ["colours_seen", "normals_seen"]

FINE = 1.0
"""A pixel of a tile is at least so many pixels of the drawing, so that threads make no moiré, or as fine as it is."""


@lru_cache(maxsize=64)  # a film asks for the same ones in every frame
def colours_seen(picture: Picture, repeats: tuple[float, float], pixel: float) -> np.ndarray:
    """(h, w, 4) float32 linear RGB and opacity. repeats: of the tile in a metre. pixel: of the drawing [m] where the
    surface is. Raises whatever pillow does for damaged files, and where there is none."""
    colours = _decoded(picture, "RGBA")
    colours[..., :3] **= 2.2
    opacity = colours[..., 3:]
    seen = _halved(np.concatenate([colours[..., :3] * opacity, opacity], axis=-1), repeats, pixel)
    seen[..., :3] /= np.maximum(seen[..., 3:], 1e-3)
    return seen


@lru_cache(maxsize=64)
def normals_seen(picture: Picture, repeats: tuple[float, float], pixel: float) -> np.ndarray:
    """(h, w, 3) float32 in [0, 1], normals as pictures hold them; see `colours_seen`. Far away a relief is flat."""
    return _halved(_decoded(picture, "RGB"), repeats, pixel)


def _decoded(picture: Picture, channels: str) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(picture.content)).convert(channels), dtype=np.float32) / 255


def _halved(image: np.ndarray, repeats: tuple[float, float], pixel: float) -> np.ndarray:
    """Until it is no finer than what is seen, each axis by itself."""
    for axis, often in ((0, repeats[1]), (1, repeats[0])):
        while image.shape[axis] % 2 == 0 and 1 / (abs(often) * image.shape[axis]) < FINE * pixel:
            pairs = np.moveaxis(image, axis, 0)
            image = np.moveaxis((pairs[::2] + pairs[1::2]) / 2, 0, axis)
    return np.ascontiguousarray(image)
