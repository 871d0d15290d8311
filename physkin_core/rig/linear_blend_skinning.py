"""Linear blend skinning: points that move with weighted means of transforms.

Dimensions: `V` vertices, `j` transforms (of joints, bones or garment nodes), `K` influences a vertex.
"""

from __future__ import annotations

import numpy as np

__all__ = ["blended_transforms", "linear_blend_skinning"]


def blended_transforms(transforms: np.ndarray, influences: np.ndarray, influence_weights: np.ndarray) -> np.ndarray:
    """(V, 3, 4) every vertex's mean of transforms (j, 3, 4). influences: (V, K) indices; influence_weights: (V, K)."""
    return np.einsum("vk,vkij->vij", influence_weights, transforms[influences])


def linear_blend_skinning(
    vertices: np.ndarray, transforms: np.ndarray, influences: np.ndarray, influence_weights: np.ndarray
) -> np.ndarray:
    """Vertices (V, 3) moved by their blended transforms. Returns (V, 3)."""
    blended = blended_transforms(transforms, influences, influence_weights)
    return np.einsum("vij,vj->vi", blended[..., :3], vertices) + blended[..., 3]
