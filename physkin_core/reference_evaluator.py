"""NumPy reference of the per-frame path, in float64: the readable statement of what the native evaluator computes.

Dimensions: `d` degrees of freedom, `b` bones, `m` garment nodes, `n` garment vertices.
"""

from __future__ import annotations

import numpy as np

from physkin_core.bound_garment import BoundGarment
from physkin_core.garment_nodes import compose_nodes, delta_transforms, pose_nodes
from physkin_core.mlp import modulated_mlp, modulation_size
from physkin_core.rig import forward_kinematics, pose_vector
from physkin_core.skinning import skin

__all__ = ["ReferenceEvaluator"]


class ReferenceEvaluator:
    """Evaluates a bound garment one pose at a time."""

    def __init__(self, bound: BoundGarment) -> None:
        self._bound = bound
        self._nodes = np.zeros((len(bound.node_bone), 3, 4))

    def evaluate(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> None:
        """Write the garment for one pose.

        joint_positions: (d,) [rad]. gravity: (3,) unit, root frame. out: (n, 3) or (n, 6) float32, any row stride.
        Raises ValueError on inputs that are not finite, TypeError when `out` is not a writable float32 array.
        """
        bound = self._bound
        q = np.asarray(joint_positions, dtype=np.float64)
        if not (np.isfinite(q).all() and np.isfinite(gravity).all()):
            raise ValueError("joint positions and gravity must be finite")
        if out.dtype != np.float32 or not out.flags.writeable or out.shape not in _shapes(bound):
            raise TypeError(f"out must be writable float32 (n, 3) or (n, 6), got {out.dtype} {out.shape}")
        heads = bound.bone_heads.astype(np.float64)
        bones = forward_kinematics(bound.bone_parents, heads, bound.dof_bone, bound.dof_axis, q - bound.dof_rest)
        pose = pose_vector(q, bound.dof_lower.astype(np.float64), bound.dof_upper.astype(np.float64), gravity)
        no_modulation = np.zeros(modulation_size(bound.pose_layers))
        modulation = modulated_mlp(bound.pose_layers, pose, no_modulation, bound.activation)
        seen = bones[bound.deformer_bones].reshape(-1)
        raw = modulated_mlp(bound.deformer_layers, seen, modulation, bound.activation)
        posed = pose_nodes(bones, bound.node_bone, bound.node_positions)
        self._nodes = compose_nodes(posed, delta_transforms(raw, len(bound.node_bone)))
        out[:, :3], normals = skin(
            self._nodes, bound.node_rest, bound.vertices, bound.normals, bound.influence_nodes, bound.influence_weights
        )
        if out.shape[1] == 6:
            out[:, 3:] = normals

    def node_transforms(self) -> np.ndarray:
        """Garment node transforms (m, 3, 4) of the last frame."""
        return self._nodes.astype(np.float32)


def _shapes(bound: BoundGarment) -> tuple[tuple[int, int], ...]:
    return (len(bound.vertices), 3), (len(bound.vertices), 6)
