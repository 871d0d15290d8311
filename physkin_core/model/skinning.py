"""Linear blend skinning of garment vertices and normals to garment nodes. Paper: Node-based Skinning for Garments.

Dimensions: `n` vertices, `m` garment nodes, `K` influences a vertex, `D` detail nodes, `J` of them a vertex. Metres,
root frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

__all__ = ["SkinningData", "skinning_matrices", "unit"]


@dataclass(frozen=True, kw_only=True)
class SkinningData:
    """A garment as skinning takes it. Float arrays are float32, all C-contiguous; metres.

    node_rest: (m, 3) garment nodes at rest on the garment (translation of chi-bar).
    vertices: (n, 3) rest garment; normals: (n, 3) unit, what skinning carries along where there
    are no faces, which give the draped garment's otherwise.
    influence_nodes: (n, K) int32; influence_weights: (n, K), rows sum to 1.
    faces: (f, 3) int32 triangles of the vertices; empty for a point set.
    detail_node_count: D. detail_nodes: (n, J) int32 that that a vertex goes with before it is skinned. detail_weights:
    (n, J). 0 and empty of a garment without detail.
    """

    node_rest: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    influence_nodes: np.ndarray
    influence_weights: np.ndarray
    faces: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=np.int32))
    detail_node_count: int = 0
    detail_nodes: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.int32))
    detail_weights: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.float32))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) at unit length; one without a length stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def skinning_matrices(nodes: np.ndarray, node_rest: np.ndarray) -> np.ndarray:
    """chi_i * inverse(chi-bar_i), chi-bar having an identity linear part. nodes: (..., m, 3, 4). Returns the same."""
    linear = nodes[..., :3]
    translation = nodes[..., 3] - np.einsum("...mij,mj->...mi", linear, node_rest)
    return np.concatenate([linear, translation[..., None]], axis=-1)
