"""What of an inner layer pokes through the one over it.

Dimensions: `n` vertices of the inner layer, `r` of the outer one, `k` points. Metres, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_paths import openings, path_lengths
from physkin_core.quality import closest_points, signed_distance

__all__ = ["HEM", "LayerPokes", "bind_layer_pokes"]

HEM = 0.03
"""Width [m] of the strip along the outer layer's openings that counts as hem: what lies under it may show."""
BELONGS = 0.15
"""[m] Cloth farther from the layer over it at rest is not under it."""
STANDS_OUT = 0.06
"""[m] What is farther outside in a pose is outside another part of the outer layer."""


@dataclass(frozen=True)
class LayerPokes:
    """Two layers, and where the one covers the other at rest.

    faces: of both, (f, 3). hem_distance: (r,) [m] along the outer layer to its closest opening. covered: (n,) bool,
    inner vertices that the outer layer covers at rest, away from its hem. covering: (r,) bool, outer ones over them.
    """

    faces: tuple[np.ndarray, np.ndarray]
    hem_distance: np.ndarray
    covered: np.ndarray
    covering: np.ndarray

    def depths(self, points: np.ndarray, normals: np.ndarray, outer: np.ndarray) -> np.ndarray:
        """How far points (k, 3) of the inner layer, with its normals (k, 3), stand out of the outer one (r, 3): (k,)
        [m]; 0 inside, where the outer layer's closest point is its hem or faces away, and from 6 cm on."""
        if len(points) == 0:
            return np.zeros(0)
        hem, alike = _closest(points, normals, outer, self.faces[1], self.hem_distance)
        outside = signed_distance(points, outer, self.faces[1])
        return np.where(alike & (hem > HEM) & (outside < STANDS_OUT), np.maximum(outside, 0), 0)


def bind_layer_pokes(inner: np.ndarray, outer: np.ndarray, faces: tuple[np.ndarray, np.ndarray]) -> LayerPokes:
    """Find what is covered. inner (n, 3) and outer (r, 3): whole layers at rest, as they are worn; faces (f, 3) of
    these, facing outwards."""
    own, over = (vertex_normals(vertices, of) for vertices, of in zip((inner, outer), faces))
    hems = path_lengths(outer, faces[1], np.concatenate([np.empty(0, dtype=int), *openings(outer, faces[1])]))
    hem, alike = _closest(inner, own, outer, faces[1], hems)
    outside = signed_distance(inner, outer, faces[1])
    covered = alike & (hem > HEM) & (np.abs(outside) < BELONGS) & (outside < STANDS_OUT)
    share, alike = _closest(outer, over, inner, faces[0], covered.astype(float))
    near = np.abs(signed_distance(outer, inner, faces[0])) < BELONGS
    return LayerPokes(faces, hems, covered, alike & near & (share > 0.5) & (hems > HEM))


def _closest(points, normals, vertices, faces, values) -> tuple[np.ndarray, np.ndarray]:
    """At the closest point of a surface to each of points (k, 3): what its vertices' values (m,) are there, and whether
    it faces as the point does, both (k,)."""
    _, face, share = closest_points(points, vertices, faces)
    corners = faces[face]
    outward = np.einsum("kj,kji->ki", share, vertex_normals(vertices, faces)[corners])
    # an infinite value, of cloth without an opening, times no share is no number
    value = (share * np.minimum(values, 1e9)[corners]).sum(axis=1)
    return value, np.einsum("ki,ki->k", outward, normals) > 0
