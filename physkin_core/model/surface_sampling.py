"""Points spread evenly over a body's surface, for the hyper modulator (paper: Hyper Modulator).

Stratified by area: the surface is cut into `count` strata of equal area, each gets one point. Strata follow the faces
in the order of a Morton curve through their centroids, so neighbouring strata are neighbours in space. The points
themselves depend on the triangulation and on `seed`; their density does not: any triangulation of the same surface
gives the same area-uniform distribution, whatever the order, size or shape of its faces, with far less noise than
independent draws.

Dimensions: `V` vertices, `f` faces, `N` points.
"""

from __future__ import annotations

import numpy as np

from physkin_core.model.garment import surface_fault

__all__ = ["sample_surface"]

MORTON_BITS = 10
GOLDEN_RATIO = (5**0.5 - 1) / 2


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, *, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Draw `count` points uniformly by area, the same ones for the same mesh and seed.

    vertices: (V, 3) [m]. faces: (f, 3) integers, counter-clockwise from outside; faces without area get no points.
    Returns points (N, 3) float32 [m] and the unit normals (N, 3) float32 of the faces they lie on.
    Raises ValueError when the count is below 1, a vertex is not finite, an index is out of range or no face has area.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    faces = np.asarray(faces)
    if count < 1:
        raise ValueError(f"count of surface points must be at least 1, got {count}")
    if fault := surface_fault(vertices, faces):
        raise ValueError(fault)
    first, second, third = (vertices[corner] for corner in faces.T)
    doubled = np.cross(second - first, third - first)
    length = np.sqrt(np.einsum("fi,fi->f", doubled, doubled))
    usable = np.flatnonzero(length > 0)
    if len(usable) == 0:
        raise ValueError(f"none of the {len(faces)} faces has an area, so there is no surface to sample")
    centroids = (first + second + third) / 3
    order = usable[np.argsort(_morton_codes(centroids[usable]), kind="stable")]
    ends = np.cumsum(length[order])

    random = np.random.default_rng(seed)
    at = (np.arange(count) + random.random(count)) / count * ends[-1]
    chosen = np.minimum(np.searchsorted(ends, at, side="right"), len(order) - 1)
    face = order[chosen]
    # Inside a face: along by the position within its share of the area, across by a golden-ratio sequence.
    along = np.clip((at - (ends[chosen] - length[face])) / length[face], 0, 1)
    across = (random.random() + GOLDEN_RATIO * np.arange(count)) % 1
    root = np.sqrt(along)
    barycentric = np.stack([1 - root, root * (1 - across), root * across], axis=1)
    points = np.einsum("nc,nci->ni", barycentric, vertices[faces[face]])
    return points.astype(np.float32), (doubled[face] / length[face, None]).astype(np.float32)


def _morton_codes(points: np.ndarray) -> np.ndarray:
    """(n,) position of each point (n, 3) along a Morton curve through the points' bounding cube."""
    low = points.min(axis=0)
    extent = max(float((points - low).max()), 1e-12)
    cells = np.minimum((points - low) / extent * 2**MORTON_BITS, 2**MORTON_BITS - 1).astype(np.int64)
    every_third = sum((np.arange(2**MORTON_BITS) >> bit & 1) << 3 * bit for bit in range(MORTON_BITS))
    x, y, z = every_third[cells.T]
    return x | y << 1 | z << 2
