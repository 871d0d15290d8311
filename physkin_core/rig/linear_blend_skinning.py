"""Linear blend skinning: points that move with weighted means of transforms.

Dimensions: `V` vertices, `j` transforms (of joints, bones or garment nodes), `K` influences a vertex.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = [
    "blended_transforms",
    "dense_weights",
    "joined_influences",
    "linear_blend_skinning",
    "strongest_influence",
    "strongest_influences",
]

VERTICES_AT_ONCE = 1 << 16
"""A transform of each influence is in memory of so many vertices."""


def blended_transforms(transforms: np.ndarray, influences: np.ndarray, influence_weights: np.ndarray) -> np.ndarray:
    """(V, 3, 4) every vertex's mean of transforms (j, 3, 4). influences: (V, K) indices; influence_weights: (V, K)."""
    return np.einsum("vk,vkij->vij", influence_weights, transforms[influences])


def linear_blend_skinning(
    vertices: np.ndarray, transforms: np.ndarray, influences: np.ndarray, influence_weights: np.ndarray
) -> np.ndarray:
    """Vertices (V, 3) moved by their blended transforms. Returns (V, 3)."""
    moved = np.empty((len(vertices), 3), dtype=np.result_type(vertices, transforms, influence_weights))
    for start in range(0, len(vertices), VERTICES_AT_ONCE):
        some = slice(start, start + VERTICES_AT_ONCE)
        blended = blended_transforms(transforms, influences[some], influence_weights[some])
        moved[some] = np.einsum("vij,vj->vi", blended[..., :3], vertices[some]) + blended[..., 3]
    return moved


def joined_influences(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Influences, or their weights, (V, K) of several meshes as of one, with zeros where some have fewer a vertex."""
    width = max(each.shape[1] for each in parts)
    return np.concatenate([np.pad(each, ((0, 0), (0, width - each.shape[1]))) for each in parts])


def dense_weights(influences: np.ndarray, influence_weights: np.ndarray, count: int) -> np.ndarray:
    """(V, count) float64 weights of all transforms; an influence named twice counts twice. influence_*: (V, K)."""
    dense = np.zeros((len(influences), count))
    np.add.at(dense, (np.arange(len(dense))[:, None], influences), influence_weights)
    return dense


def strongest_influence(influences: np.ndarray, influence_weights: np.ndarray) -> np.ndarray:
    """(V,) the transform that each vertex hangs on most. influence_*: (V, K)."""
    return influences[np.arange(len(influences)), influence_weights.argmax(axis=1)]


def strongest_influences(dense: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The `count` largest of dense weights (V, j): indices and weights (V, count), rows summing to 1."""
    strongest = np.argsort(-dense, axis=1, kind="stable")[:, :count]
    weights = np.take_along_axis(dense, strongest, axis=1)
    return strongest, weights / weights.sum(axis=1, keepdims=True)
