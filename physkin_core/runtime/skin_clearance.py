"""Cloth at rest kept as clear of an avatar's skin as networks keep it of the body that they see.

What carries cloth from that body to the avatar is smooth; skin with ridges, joints of a doll, is not. Vertices that
come too near are moved out, and with them, less, those around. Once, when the garment is bound.

Dimensions: `n` garment vertices. Metres, root frame, canonical pose.
"""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_sampling import sample_surface

__all__ = ["SkinClearance", "move_clear"]

POINTS = 32768
"""Points sampled on a body."""
CLEAR = 0.004
"""[m] Cloth farther from the skin than this is left where it is."""
FAR = 0.05
"""[m] A vertex with no skin so near that faces as it does is left where it is."""
RADIUS = 0.02
"""[m] length over which vertices move along with those that must."""
NEIGHBOURS = 32
ROUNDS = 6
AT_REST = 0.3
"""What a vertex that need not move counts, against one that must, in how those around them move."""


class SkinClearance:
    """Measures how far points that face outward are from a body's skin."""

    def __init__(self, body: Avatar) -> None:
        from scipy.spatial import cKDTree

        self._points, self._normals = (a.astype(np.float64) for a in sample_surface(body.vertices, body.faces, POINTS))
        self._tree = cKDTree(with_normals(self._points, self._normals))

    def __call__(self, vertices: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Clearance (n,) [m] of vertices (n, 3) with normals (n, 3), negative inside, and the skin's normals (n, 3)."""
        match = self._tree.query(with_normals(vertices, normals))[1]
        gap = vertices - self._points[match]
        off = np.einsum("ni,ni->n", gap, self._normals[match])
        return np.where(np.linalg.norm(gap, axis=1) < FAR, off, np.inf), self._normals[match]


def move_clear(vertices: np.ndarray, faces: np.ndarray, wanted: np.ndarray, skin: SkinClearance) -> np.ndarray:
    """Displacement (n, 3) [m] that gives cloth (n, 3) its wanted clearance (n,) of a skin, or `CLEAR` if that is less."""
    from scipy.spatial import cKDTree

    wanted = np.minimum(wanted, CLEAR)
    distance, near = cKDTree(vertices).query(vertices, k=min(NEIGHBOURS, len(vertices)))
    closeness = np.exp(-((distance / RADIUS) ** 2))
    moved = np.zeros_like(vertices)
    for _ in range(ROUNDS):
        there = vertices + moved
        clearance, outward = skin(there, vertex_normals(there, faces))
        lack = np.maximum(wanted - clearance, 0)
        if not lack.any():
            break
        share = closeness * np.where(lack > 0, 1.0, AT_REST)[near]
        share /= share.sum(axis=1, keepdims=True)
        moved += np.einsum("nk,nki->ni", share, (lack[:, None] * outward)[near])
    return moved
