"""Vertex normals of meshes that share their faces, in torch."""

from __future__ import annotations

import torch

__all__ = ["area_normals"]


def area_normals(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Sums of the normals of the faces around each vertex, twice as long as their areas: (B, n, 3).

    vertices: (B, n, 3). faces: (f, 3) int64. A vertex that no face uses gets zero. At unit length they are those of
    `physkin_core.model.garment.vertex_normals`.
    """
    corners = vertices[:, faces]
    cross = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normals = torch.zeros_like(vertices)
    for corner in range(3):
        normals.index_add_(1, faces[:, corner], cross)
    return normals
