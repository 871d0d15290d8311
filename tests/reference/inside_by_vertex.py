"""Which garment vertices are inside a body by its nearest vertex: slow and plain."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree


def inside_by_vertex(points: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) are behind the nearest body vertex, by its area-weighted normal. Returns (n,) bool.

    As GAPS counts them (Chen et al. 2024), for comparison: unlike the sign of `signed_distance` it depends on how the
    body is triangulated.
    """
    corners = np.asarray(body_vertices, dtype=np.float64)[body_faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((len(body_vertices), 3))
    np.add.at(normals, body_faces, cross[:, None])
    _, nearest = cKDTree(body_vertices).query(points)
    return ((points - body_vertices[nearest]) * normals[nearest]).sum(axis=-1) < 0
