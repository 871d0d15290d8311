"""Skinning alone in C++: garment vertices from garment nodes that somebody else computed.

Dimensions: `n` vertices, `m` garment nodes, `K` influences a vertex. Metres, root frame.
"""

from __future__ import annotations

import numpy as np

from physkin_core.model.skinning import SkinningData
from physkin_core.runtime.native_evaluator import _native

__all__ = ["NativeSkinner"]


class NativeSkinner:
    """Skins one garment, as `NativeEvaluator.skin` does, without having its networks. Not for two threads at once.

    vertices, normals: (n, 3) rest garment [m] and unit normals. node_rest: (m, 3) [m]. influence_nodes: (n, K) int32;
    influence_weights: (n, K), rows sum to 1. All float32.
    Raises ValueError when a shape or dtype is another, an index out of range or a value not finite.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        normals: np.ndarray,
        node_rest: np.ndarray,
        influence_nodes: np.ndarray,
        influence_weights: np.ndarray,
    ) -> None:
        self.vertex_count, self.node_count = len(vertices), len(node_rest)
        self._skinner = _native.Skinner(
            SkinningData(
                node_rest=node_rest,
                vertices=vertices,
                normals=normals,
                influence_nodes=influence_nodes,
                influence_weights=influence_weights,
            )
        )

    def skin(self, node_transforms: np.ndarray, out: np.ndarray) -> None:
        """Write x, y, z [m] and unit normals into `out`, (n, 6) or (n, 3) float32, from node_transforms (m, 3, 4).

        Raises TypeError or ValueError as `NativeEvaluator.skin` does.
        """
        self._skinner.skin(node_transforms, out)
