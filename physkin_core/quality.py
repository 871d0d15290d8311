"""Quality figures of a drape: strain, contact and jitter, as the README's tables state them.

Dimensions: `...` samples, `n` garment vertices, `T` frames. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.model.garment import Garment, face_areas

__all__ = [
    *("CLOSE", "area_strain", "closest_points", "contact_figures", "edge_strain", "edge_strains", "jitter"),
    "signed_distance",
]

CLOSE = 0.003
"""Garment vertices nearer to the body than this [m] are counted as close."""

ON_EDGE = 1e-6
"""A closest point with a smaller barycentric coordinate lies on the edge."""


def edge_strain(garment: Garment, vertices: np.ndarray) -> np.ndarray:
    """eps_e: mean |l - l0| / l0 over edges [%] (paper: Error Metrics). vertices: (..., n, 3). Returns (...)."""
    return edge_strains(garment, vertices).mean(axis=-1)


def edge_strains(garment: Garment, vertices: np.ndarray) -> np.ndarray:
    """|l - l0| / l0 of every edge [%]. vertices: (..., n, 3). Returns (..., e), in the order of `Garment.edges`."""
    ends = vertices[..., garment.edges, :]
    length = np.linalg.norm(ends[..., 1, :] - ends[..., 0, :], axis=-1)
    return 100 * np.abs(length - garment.edge_lengths) / garment.edge_lengths


def area_strain(garment: Garment, vertices: np.ndarray) -> np.ndarray:
    """eps_a: mean |A - A0| / A0 over faces [%]. vertices: (..., n, 3). Returns (...)."""
    return 100 * (np.abs(face_areas(vertices, garment.faces) - garment.face_areas) / garment.face_areas).mean(axis=-1)


def closest_points(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The closest point of a surface to each of points (n, 3): its distance (n,) [m], its face (n,) and where it is on
    that, barycentric (n, 3). vertices: (V, 3) [m], faces: (f, 3)."""
    from point_cloud_utils import closest_points_on_mesh

    count = len(points)
    if count == 1:  # the library reads the arrays in another order then
        points = np.repeat(points, 2, axis=0)
    points, vertices = (np.ascontiguousarray(x, dtype=np.float64) for x in (points, vertices))
    found = closest_points_on_mesh(points, vertices, np.ascontiguousarray(faces, dtype=np.int64))
    distance, face, barycentric = (x[:count] for x in found)
    return distance, face, barycentric


def signed_distance(points: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> np.ndarray:
    """Distance to the closest point of a closed body surface [m], negative inside. points: (n, 3). Returns (n,).

    The sign is that of the angle-weighted pseudo-normal at the closest point (Baerentzen and Aanaes 2005), as in the
    training's contact: where a body intersects itself, its nearest skin decides, and edges and corners are exact.
    """
    points, vertices = (np.asarray(x, dtype=np.float64) for x in (points, body_vertices))
    faces = np.asarray(body_faces, dtype=np.int64)
    distance, face, barycentric = closest_points(points, vertices, faces)
    closest = np.einsum("nk,nki->ni", barycentric, vertices[faces[face]])
    first, second, third = (vertices[corner] for corner in faces[face].T)
    normal = np.cross(second - first, third - first)
    touched = (barycentric > ON_EDGE).sum(axis=1)  # corners with a share: 1 at a corner, 2 on an edge
    beside = np.flatnonzero((touched == 1) | (touched == 2))
    if len(beside):
        seen = np.zeros(len(vertices), dtype=bool)
        seen[faces[face[beside]]] = True
        around = np.flatnonzero(seen[faces].any(axis=1))
        at_edge, at_corner = _pseudo_normals(vertices, faces[around])
        share, touched, face = barycentric[beside], touched[beside, None], face[beside]
        on_edge = at_edge[np.searchsorted(around, face), share.argmin(axis=1)]
        normal[beside] = np.where(touched == 2, on_edge, at_corner[faces[face, share.argmax(axis=1)]])
    return np.where(((points - closest) * normal).sum(axis=1) < 0, -distance, distance)


def _pseudo_normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the edge opposite each face's corner (f, 3, 3); of vertices (n, 3), angle-weighted."""
    sides = np.roll(vertices[faces], -1, axis=1) - vertices[faces]  # from corner k to corner k + 1
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    back = -np.roll(sides, 1, axis=1)
    angles = np.arctan2(np.linalg.norm(np.cross(sides, back), axis=-1), (sides * back).sum(axis=-1))
    at_corner = np.zeros((len(vertices), 3))
    np.add.at(at_corner, faces, angles[..., None] * normals[:, None])
    ends = np.sort(np.stack([np.roll(faces, -1, axis=1), np.roll(faces, -2, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    edges, owner = np.unique(ends @ [len(vertices), 1], return_inverse=True)  # one number an edge sorts faster
    at_edge = np.zeros((len(edges), 3))
    np.add.at(at_edge, owner.reshape(faces.shape), normals[:, None])
    return at_edge[owner.reshape(faces.shape)], at_corner


def contact_figures(distances: np.ndarray) -> dict[str, float]:
    """Share of vertices inside the body (eps_c) and closer than 3 mm [%], and deepest penetration [mm].

    distances: signed distance [m], any shape.
    """
    return {
        "inside_percent": float(100 * (distances < 0).mean()),
        "within_3mm_percent": float(100 * (distances < CLOSE).mean()),
        "max_depth_mm": float(1000 * max(0.0, -distances.min())),
    }


def jitter(frames: np.ndarray) -> float:
    """Mean second difference of vertex positions over frames (T, n, 3) [m per frame squared]. Raises ValueError for
    less than 3 frames."""
    if len(frames) < 3:
        raise ValueError(f"jitter needs at least 3 frames, got {len(frames)}")
    return float(np.linalg.norm(np.diff(frames, n=2, axis=0), axis=-1).mean())
