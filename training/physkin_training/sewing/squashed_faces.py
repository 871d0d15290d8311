"""Faces of sewn cloth that a fold of the body has squashed, between thighs that touch say, pulled open again.

Dimensions: `n` vertices, `f` faces, `t` places on the flat cloth. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.model.garment import face_areas
from physkin_core.model.rest_shape import flat_areas

__all__ = ["opened", "squashed"]

SQUASHED = 2.5
"""A face is pulled open if its area and that on its panel differ by this factor or more. A garment may have up to 3."""
MOST_SQUASHED = 0.005
"""Share of the faces. If more are squashed, it is not a fold."""
ROUNDS = 100
"""How often edges are drawn to their length."""


def squashed(vertices: np.ndarray, faces: np.ndarray, places: np.ndarray, panel_faces: np.ndarray) -> np.ndarray:
    """Which faces (f,) of vertices (n, 3) are much smaller or larger than on the flat cloth, `places` (t, 2)."""
    times = face_areas(vertices, faces) / np.abs(flat_areas(places[panel_faces]))
    return (times < 1 / SQUASHED) | (times > SQUASHED)


def opened(vertices: np.ndarray, faces: np.ndarray, places: np.ndarray, panel_faces: np.ndarray) -> np.ndarray:
    """Vertices (n, 3) with which squashed faces and their neighbours have edges about as long as on the flat cloth,
    whatever the body. They stay the same if no face is squashed, or more than `MOST_SQUASHED` are."""
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
        edges = found[ends[:, 1]] - found[ends[:, 0]]
        half = (1 - lengths / np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-9)) * edges / 2
        pull = np.zeros_like(found)
        np.add.at(pull, ends[:, 0], half)
        np.add.at(pull, ends[:, 1], -half)
        found[moved] += pull[moved] / count
    return found
