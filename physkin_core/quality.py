"""Quality figures of a drape: strain, contact and jitter, as the README's tables state them.

Dimensions: `...` samples, `n` garment vertices, `T` frames. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.garment import Garment, face_areas

__all__ = ["area_strain", "contact_figures", "edge_strain", "jitter", "signed_distance"]


def edge_strain(garment: Garment, vertices: np.ndarray) -> np.ndarray:
    """eps_e: mean |l - l0| / l0 over edges [%] (paper: Error Metrics). vertices: (..., n, 3). Returns (...)."""
    ends = vertices[..., garment.edges, :]
    length = np.linalg.norm(ends[..., 1, :] - ends[..., 0, :], axis=-1)
    return 100 * (np.abs(length - garment.edge_lengths) / garment.edge_lengths).mean(axis=-1)


def area_strain(garment: Garment, vertices: np.ndarray) -> np.ndarray:
    """eps_a: mean |A - A0| / A0 over faces [%]. vertices: (..., n, 3). Returns (...)."""
    return 100 * (np.abs(face_areas(vertices, garment.faces) - garment.face_areas) / garment.face_areas).mean(axis=-1)


def signed_distance(points: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> np.ndarray:
    """Distance to the closest point of a closed body surface [m], negative inside. points: (n, 3). Returns (n,)."""
    import trimesh

    body = trimesh.Trimesh(body_vertices, body_faces, process=False)
    return -trimesh.proximity.signed_distance(body, points)


def contact_figures(distances: np.ndarray) -> dict[str, float]:
    """Share of vertices inside the body (eps_c) and closer than 3 mm [%], and deepest penetration [mm].

    distances: signed distance [m], any shape.
    """
    return {
        "inside_percent": float(100 * (distances < 0).mean()),
        "within_3mm_percent": float(100 * (distances < 0.003).mean()),
        "max_depth_mm": float(1000 * max(0.0, -distances.min())),
    }


def jitter(frames: np.ndarray) -> float:
    """Mean second difference of vertex positions over frames (T, n, 3) [m per frame squared]."""
    if len(frames) < 3:
        raise ValueError(f"jitter needs at least 3 frames, got {len(frames)}")
    return float(np.linalg.norm(np.diff(frames, n=2, axis=0), axis=-1).mean())
