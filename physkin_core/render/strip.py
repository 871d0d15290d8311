"""A strip: frames of a draped motion beside each other, from the front and the back. Metres, root frame."""

from __future__ import annotations

import numpy as np

from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import contact_sheet, render
from physkin_core.progress import Watch
from physkin_core.render.dressed_meshes import dressed_meshes

__all__ = ["MOST_FRAMES", "draw_strip"]

MOST_FRAMES = 24
FRAME_SIZE = 180, 320
"""Of a frame in a strip, width and height [pixels]."""
VIEWS = 15.0, 195.0
"""Azimuths [degrees] of a strip's two rows."""
AROUND = 0.05
"""[m] Room about the body."""


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
            body = outfit.posed_body(positions)
            columns.append((dressed_meshes(outfit, body, cloth), body))
    half = max(np.abs(body - _middle(body)).max(axis=0).max() for _, body in columns) + AROUND
    pictures = []
    for azimuth in VIEWS:
        for meshes, body in columns:
            bounds = _middle(body) + _box(half)
            pictures.append(render(meshes, size=FRAME_SIZE, azimuth=azimuth, bounds=bounds, samples=8))
            watch(len(pictures) / (len(VIEWS) * count))
    return contact_sheet(pictures, columns=count, gap=2)


def _middle(body: np.ndarray) -> np.ndarray:
    return (body.min(axis=0) + body.max(axis=0)) / 2


def _box(half: float) -> np.ndarray:
    """(2, 3) [m] about the origin, as wide as a frame is for its height."""
    across = half * FRAME_SIZE[0] / FRAME_SIZE[1]
    return np.array([[-across, -across, -half], [across, across, half]])
