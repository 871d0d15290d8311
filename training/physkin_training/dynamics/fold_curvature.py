"""How strongly cloth is bent where points of it are, from where their neighbours are.

Folds show in it that are at least two or three times as wide as points lie apart: with the 96 points of a reference the
flutes of a skirt, not its wrinkles.

Dimensions: `T` frames, `k` points, `q` neighbours. Metres.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from physkin_core.model.garment import Garment, vertex_normals

__all__ = ["NEIGHBOURS", "FoldCurvature"]

NEIGHBOURS = 6


class FoldCurvature:
    """Of points of a garment, `vertices` (k,), whose neighbours are the nearest along its edges at rest. Raises
    ValueError for fewer than seven."""

    def __init__(self, garment: Garment, vertices: np.ndarray) -> None:
        if len(vertices) <= NEIGHBOURS:
            raise ValueError(f"curvature is of at least {NEIGHBOURS + 1} points, got {len(vertices)}")
        (here, there), count = garment.edges.T, len(garment.vertices)
        edges = csr_array((garment.edge_lengths, (here, there)), shape=(count, count))
        away = dijkstra(edges, directed=False, indices=vertices)[:, vertices]
        nearest = np.argsort(away, axis=1)[:, 1 : 1 + NEIGHBOURS]
        normals = vertex_normals(garment.vertices, garment.faces)[vertices]
        places = garment.vertices[vertices]
        ways = places[nearest] - places[:, None]
        first = np.cross(normals, ways[:, 0])
        second = np.cross(normals, first)
        angles = np.arctan2(*(np.einsum("kqd,kd->kq", ways, axis) for axis in (first, second)))
        self._around = np.take_along_axis(nearest, np.argsort(angles, axis=1), axis=1)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Mean curvatures (T, k) [1/m] of points (T, k, 3); of a cylinder one over twice its radius."""
        ways = points[:, self._around].astype(np.float64) - points[:, :, None]
        normals = np.cross(ways, np.roll(ways, -1, axis=2)).sum(axis=2)
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        heights = np.einsum("tkqd,tkd->tkq", ways, normals)
        return 2 * (heights / (ways**2).sum(axis=3)).mean(axis=2)
