"""What an outfit covers: cloth and skin that nobody sees in everyday poses need not be computed or drawn.

A point is covered where the closest cloth that faces alike is not near that cloth's hem: an opening shows what lies
under it as deep as it gapes. Conservative: it must hold in every pose looked at.

Dimensions: `n` garment vertices, `f` faces, `k` points. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.surface_paths import openings, path_lengths

__all__ = ["Cover", "covered", "faces_of", "hem_distances"]

FROM_HEM = 0.03
"""[m] along the cover, from its hem, within which nothing under it is hidden."""
STANDS_OUT = 0.05
"""[m] A point farther outside its cover than this does not belong to it."""


@dataclass(frozen=True)
class Cover:
    """A garment in a pose. vertices, normals: (n, 3). hem_distance: (n,) [m] along the cloth to its closest opening."""

    vertices: np.ndarray
    normals: np.ndarray
    hem_distance: np.ndarray


def hem_distances(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(n,) [m] along a garment at rest from each vertex to its closest opening."""
    return path_lengths(vertices, faces, np.concatenate([np.empty(0, dtype=int), *openings(vertices, faces)]))


def covered(points: np.ndarray, normals: np.ndarray, covers: Sequence[Cover]) -> np.ndarray:
    """Which of points (k, 3) with outward normals (k, 3) are under one of the covers: (k,) bool."""
    from scipy.spatial import cKDTree

    under = np.zeros(len(points), dtype=bool)
    for cover in covers:
        left = np.flatnonzero(~under)
        tree = cKDTree(with_normals(cover.vertices, cover.normals))
        match = tree.query(with_normals(points[left], normals[left]))[1]
        gap = cover.vertices[match] - points[left]
        height = np.einsum("ki,ki->k", gap, normals[left])
        alike = np.einsum("ki,ki->k", cover.normals[match], normals[left]) > 0
        inwards = cover.hem_distance[match] >= FROM_HEM + np.linalg.norm(gap, axis=1)
        under[left] = alike & inwards & (height > -STANDS_OUT)
    return under


def faces_of(faces: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """(f,) bool: faces (f, 3) all of whose corners are hidden (n,)."""
    return hidden[faces].all(axis=1)
