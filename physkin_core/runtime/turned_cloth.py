"""Cloth that is turned inside out: a lapel and the fall of a collar lie folded over what they continue, so that their
outside faces the body.

Dimensions: `n` garment vertices, `f` faces. Metres, root frame, canonical pose.
"""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import face_areas, vertex_normals
from physkin_core.model.surface_paths import mesh_edges, pieces

__all__ = ["turned_cloth"]

NEAR, FACING, LEAST = 0.04, -0.3, 30e-4
"""It is this near to the skin [m], the cosine between its normal and that of the skin is less than this, and a piece
of it has this area at least [m2]: less is a fold."""


def turned_cloth(rest: np.ndarray, faces: np.ndarray, avatar: Avatar) -> np.ndarray:
    """Which vertices (n,) bool of a garment, rest (n, 6) with unit normals and faces (f, 3), are turned inside out."""
    from scipy.spatial import cKDTree

    distance, closest = cKDTree(avatar.vertices).query(rest[:, :3])
    outward = vertex_normals(avatar.vertices, avatar.faces)[closest]
    turned = (distance < NEAR) & (np.einsum("ni,ni->n", outward, rest[:, 3:]) < FACING)
    inner = faces[turned[faces].all(axis=1)]
    piece = pieces(mesh_edges(inner)[0], len(rest))
    areas = np.bincount(piece[inner[:, 0]], face_areas(rest[:, :3], inner), minlength=len(rest))
    return turned & (areas[piece] >= LEAST)
