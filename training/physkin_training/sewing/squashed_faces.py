"""Faces of sewn cloth that a fold of the body has squashed, between thighs that touch say, pulled open again.

Dimensions: `n` vertices, `f` faces, `t` places on the flat cloth. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.model.garment import face_areas
from physkin_core.model.rest_shape import flat_areas

__all__ = ["opened", "squashed"]

SQUASHED = 2.5
"""Times by which the areas of a face and its panel's differ, from which on it is pulled open; up to 3 may be left."""
MOST_SQUASHED = 0.005
"""Share of the faces; more are no fold."""
ROUNDS = 100
"""Of drawing edges to their length."""


def squashed(vertices: np.ndarray, faces: np.ndarray, places: np.ndarray, panel_faces: np.ndarray) -> np.ndarray:
    """Which faces (f,) of vertices (n, 3) are much smaller or larger than on the flat cloth, `places` (t, 2)."""
    times = face_areas(vertices, faces) / np.abs(flat_areas(places[panel_faces]))
    return (times < 1 / SQUASHED) | (times > SQUASHED)


def opened(vertices: np.ndarray, faces: np.ndarray, places: np.ndarray, panel_faces: np.ndarray) -> np.ndarray:
    """Vertices (n, 3) in which squashed faces, and their neighbours, have edges about as long as on the flat cloth; the
    body is not heeded. The same vertices where no face is squashed, or more than `MOST_SQUASHED` are."""
    bad = squashed(vertices, faces, places, panel_faces)
    if not bad.any() or bad.mean() > MOST_SQUASHED:
        return vertices
    around = np.isin(faces, faces[bad]).any(axis=1)
    moved = np.unique(faces[around])
    sides = np.isin(faces, moved).any(axis=1)
    ends = np.stack([faces[sides], np.roll(faces[sides], -1, axis=1)], axis=-1).reshape(-1, 2)
    corners = places[panel_faces[sides]]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).reshape(-1, 1)
    count, found = np.bincount(ends.ravel(), minlength=len(vertices))[moved, None], vertices.copy()
    for _ in range(ROUNDS):
        ways = found[ends[:, 1]] - found[ends[:, 0]]
        half = (1 - lengths / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)) * ways / 2
        pull = np.zeros_like(found)
        np.add.at(pull, ends[:, 0], half)
        np.add.at(pull, ends[:, 1], -half)
        found[moved] += pull[moved] / count
    return found
