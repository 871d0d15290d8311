"""The two per-frame networks as one folded graph, for engines that compete with the native evaluator.

Dimensions: `p` pose vector, `u` bones that garment nodes follow, `h` node deformer width, `m` garment nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.model.mlp import Layer
from physkin_core.rig.rig import forward_kinematics, pose_vector
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Evaluator

__all__ = ["NetworkCase", "network_case"]


@dataclass(frozen=True)
class NetworkCase:
    """Graph, input and right answer of a network peer.

    hidden: the pose modulator's hidden layers. heads: its output layer cut in two for each hidden layer of the node
    deformer, 1 + scale and shift, so that no engine has to add the one or to cut the vector.
    deformer: the node deformer's layers, over bone transforms. detail: one layer from what the last of these reads to
    features, or none.
    pose: (1, p) and bones: (1, 12 u) float32 inputs. expected: (1, 12 m + F) outputs, corrections and then features.
    """

    hidden: tuple[Layer, ...]
    heads: tuple[tuple[Layer, Layer], ...]
    deformer: tuple[Layer, ...]
    detail: tuple[Layer, ...]
    pose: np.ndarray
    bones: np.ndarray
    expected: np.ndarray

    @property
    def weight_count(self) -> int:
        """Network weights of the graph, biases not counted: the multiply-adds of a run."""
        heads = [layer for pair in self.heads for layer in pair]
        return sum(weight.size for weight, _ in (*self.hidden, *heads, *self.deformer, *self.detail))


def network_case(
    bound: BoundGarment, joint_positions: np.ndarray, gravity: np.ndarray, evaluator: Evaluator
) -> NetworkCase:
    """The networks of a bound garment at one pose, which an evaluator has just draped. joint_positions: (d,) [rad];
    gravity: (3,) unit, root frame."""
    q = joint_positions.astype(np.float64)
    heads = bound.bone_heads.astype(np.float64)
    bones = forward_kinematics(bound.bone_parents, heads, bound.dof_bone, bound.dof_axis, q - bound.dof_rest)
    pose = pose_vector(q, bound.dof_lower.astype(np.float64), bound.dof_upper.astype(np.float64), gravity)
    used = bones[bound.deformer_bones]
    *hidden, (weight, bias) = bound.pose_layers
    pairs, start = [], 0
    for _, hidden_bias in bound.deformer_layers[:-1]:
        width = len(hidden_bias)
        scale, shift = slice(start, start + width), slice(start + width, start + 2 * width)
        pairs.append(((weight[scale], bias[scale] + np.float32(1)), (weight[shift], bias[shift])))
        start = shift.stop
    return NetworkCase(
        hidden=tuple(hidden),
        heads=tuple(pairs),
        deformer=bound.deformer_layers,
        detail=bound.detail_layers,
        pose=np.ascontiguousarray(pose[None], dtype=np.float32),
        bones=np.ascontiguousarray(used.reshape(1, -1), dtype=np.float32),
        expected=np.concatenate([evaluator.corrections().ravel(), evaluator.features()])[None],
    )
