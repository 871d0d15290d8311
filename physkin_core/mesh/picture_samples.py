"""A picture looked at where faces have their texture coordinates.

Dimensions: `k` faces.
"""

from __future__ import annotations

import io
from typing import Literal

import numpy as np

__all__ = ["sampled_picture"]

SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / [[3], [6], [6], [6]]
"""Where in a triangle a picture is looked at: shares of its corners."""
LARGEST_PICTURE = 512
"""[pixels] a side; larger ones are made smaller first, so that a sample is the mean of what is about it."""


def sampled_picture(content: bytes, uv: np.ndarray, channels: Literal["RGB", "A"]) -> np.ndarray:
    """Samples (4, k, 3) of a picture's colours or (4, k) of its opacity, in [0, 1], in each face's triangle of texture
    places (k, 3, 2), origin at the lower left. Raises whatever pillow does: for damaged files, or where there is none.
    """
    from PIL import Image

    image = Image.open(io.BytesIO(content))
    image = image.convert("RGB") if channels == "RGB" else image.convert("RGBA").getchannel("A")
    image.thumbnail((LARGEST_PICTURE, LARGEST_PICTURE), Image.Resampling.BOX)
    pixels = np.asarray(image) / 255.0
    u, v = np.moveaxis(np.einsum("sc,kcu->ksu", SAMPLES, np.nan_to_num(uv)), 2, 0)
    rows, columns = pixels.shape[:2]
    row = np.floor((1 - v) % 1 * rows).astype(int) % rows
    column = np.floor(u % 1 * columns).astype(int) % columns
    return np.moveaxis(pixels[row, column], 1, 0)
