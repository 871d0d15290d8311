"""Skinning alone in C++: garment vertices from garment nodes that somebody else computed.

Dimensions: `n` vertices, `m` garment nodes, `K` influences a vertex. Metres, root frame.
"""

from __future__ import annotations

import numpy as np

from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.native_evaluator import NativeEvaluator

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
        node_count = len(node_rest)

        def silent(outputs: int, inputs: int) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros((outputs, inputs), dtype=np.float32), np.zeros(outputs, dtype=np.float32)

        one_bone = dict(
            bone_parents=np.array([-1], dtype=np.int32),
            bone_heads=np.zeros((1, 3), dtype=np.float32),
            dof_bone=np.zeros(1, dtype=np.int32),
            dof_axis=np.array([[0, 0, 1]], dtype=np.float32),
            dof_rest=np.zeros(1, dtype=np.float32),
            dof_lower=np.array([-1], dtype=np.float32),
            dof_upper=np.array([1], dtype=np.float32),
            deformer_bones=np.zeros(1, dtype=np.int32),
            node_bone=np.zeros(node_count, dtype=np.int32),
        )
        self.vertex_count, self.node_count = len(vertices), node_count
        self._evaluator = NativeEvaluator(
            BoundGarment(
                **one_bone,
                pose_layers=(silent(2, 4),),
                deformer_layers=(silent(1, 12), silent(9 * node_count, 1)),
                node_positions=node_rest,
                node_rest=node_rest,
                vertices=vertices,
                normals=normals,
                influence_nodes=influence_nodes,
                influence_weights=influence_weights,
            ),
            precision="fp32",
        )

    def skin(self, node_transforms: np.ndarray, out: np.ndarray) -> None:
        """Write x, y, z [m] and unit normals into `out`, (n, 6) or (n, 3) float32, from node_transforms (m, 3, 4).

        Raises TypeError or ValueError as `NativeEvaluator.skin` does.
        """
        self._evaluator.skin(node_transforms, out)
