"""NumPy reference of the per-frame path, in float64: the readable statement of what the native evaluator computes.

Dimensions: `d` degrees of freedom, `b` bones, `m` garment nodes, `n` garment vertices.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from physkin_core.model.garment import vertex_normals
from physkin_core.model.garment_nodes import compose_nodes, delta_transforms, pose_nodes
from physkin_core.model.node_deformer import node_corrections
from physkin_core.model.pose_modulator import pose_modulation
from physkin_core.model.skinning import NORMALS, skin
from physkin_core.rig.rig import forward_kinematics, pose_vector
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.sway.learnt_sway import LearntSway
from physkin_core.sway.moment import GRAVITY_SIZES, Moment, split_moment
from physkin_core.sway.node_twist import twisted
from physkin_core.sway.pace import JUMP, UNTOLD, Pace

__all__ = ["ReferenceEvaluator"]

LARGEST = 1e6
"""A number beyond this, or none at all, is refused, as by the native evaluator: no drape comes near."""


class ReferenceEvaluator:
    """Evaluates a bound garment one pose at a time.

    normals: as in `NativeEvaluator`. jumped: whether a joint, or gravity, was far from where the frame before had it.
    Raises ValueError for unknown normals, or those of faces without faces.
    """

    instruction_set = "numpy"
    precision = "fp32"

    def __init__(
        self,
        bound: BoundGarment,
        *,
        normals: Literal["skinned", "faces"] = "skinned",
    ) -> None:
        if normals not in NORMALS:
            raise ValueError(f"normals {normals!r} are unknown; they may be {' or '.join(NORMALS)}")
        if normals == "faces" and len(bound.faces) == 0:
            raise ValueError("normals of faces need a garment with faces; this one has none")
        self._normals_of_faces = normals == "faces"
        self._bound = bound
        self._nodes = np.zeros((len(bound.node_bone), 3, 4))
        self._pace, self._last_given = Pace(), None
        self._learnt_sway = None
        if bound.sway_layers:
            limits, oscillators = (bound.dof_lower, bound.dof_upper), (bound.sway_rates, bound.sway_turns)
            self._learnt_sway = LearntSway(bound.sway_joints, *limits, bound.sway_layers, *oscillators)
        self.jumped = True

    def evaluate(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> None:
        """Write the garment for one pose.

        joint_positions: (d,) [rad]. gravity: (3,) unit, root frame, or with the moment behind it, as of
        `physkin_core.sway.moment`. out: (n, 3) or (n, 6) float32, any row stride.
        Raises what the native evaluator raises: TypeError when an array has another dtype or `out` is not a writable
        2-D one; ValueError when a shape is wrong, rows of `out` overlap or are not contiguous, or an input or what the
        networks make of it is not finite. Nothing is written then.
        """
        bound = self._bound
        _check_input("joint_positions", joint_positions, len(bound.dof_bone))
        size = len(gravity) if np.shape(gravity) in [(size,) for size in GRAVITY_SIZES] else 3
        _check_input("gravity", gravity, size)
        gravity, moment = split_moment(gravity)
        _check_out(out, len(bound.vertices))
        q = joint_positions.astype(np.float64)
        given = np.concatenate([q, gravity])
        self.jumped = self._last_given is None or np.abs(given - self._last_given).max() > JUMP
        self._last_given = given
        try:
            self._nodes = self._nodes_of(q, gravity.astype(np.float64), moment)
        except ValueError:
            self._forget()
            raise
        positions, normals = skin(
            self._nodes, bound.node_rest, bound.vertices, bound.normals, bound.influence_nodes, bound.influence_weights
        )
        if self._normals_of_faces and out.shape[1] == 6:
            normals = vertex_normals(positions, bound.faces)
        out[:, :3] = positions
        if out.shape[1] == 6:
            out[:, 3:] = normals

    def _nodes_of(self, q: np.ndarray, gravity: np.ndarray, moment: Moment | None) -> np.ndarray:
        """Garment nodes (m, 3, 4). Raises ValueError where networks give what is not finite."""
        bound = self._bound
        heads = bound.bone_heads.astype(np.float64)
        bones = forward_kinematics(bound.bone_parents, heads, bound.dof_bone, bound.dof_axis, q - bound.dof_rest)
        pose = pose_vector(q, bound.dof_lower.astype(np.float64), bound.dof_upper.astype(np.float64), gravity)
        modulation = pose_modulation(
            bound.pose_layers, pose, bound.pose_modulation if len(bound.pose_modulation) else None
        )
        raw = node_corrections(bound.deformer_layers, bones[bound.deformer_bones], modulation)
        if moment is not None and self._learnt_sway is not None:
            if moment.sway > 0:
                raw = raw + moment.sway * self._learnt_sway.offsets(q, gravity, moment)
            else:
                self._learnt_sway.forget()
        _check_result("node deformer output", raw)
        posed = pose_nodes(bones, bound.node_bone, bound.node_positions)
        nodes = compose_nodes(posed, delta_transforms(raw, len(bound.node_bone)))
        _check_result("node_transforms", nodes)
        if moment is None:
            return nodes
        nodes = self._pace.kept(posed, nodes, UNTOLD if self.jumped else moment.passed)
        if moment.twist and len(bound.node_twist):
            nodes = twisted(nodes, bones, bound.node_twist.astype(np.float64), bound.node_bone, moment.twist)
        return nodes

    def _forget(self) -> None:
        """What was before does not count for the next frame."""
        self._pace = Pace()
        if self._learnt_sway is not None:
            self._learnt_sway.forget()

    def node_transforms(self) -> np.ndarray:
        """Garment node transforms (m, 3, 4) of the last frame."""
        return self._nodes.astype(np.float32)


def _check_input(name: str, values: np.ndarray, count: int) -> None:
    if not isinstance(values, np.ndarray) or values.dtype not in (np.float32, np.float64):
        raise TypeError(f"{name} must be a float32 or float64 array, got {getattr(values, 'dtype', type(values))}")
    if values.shape != (count,):
        raise ValueError(f"{name} must have shape ({count},), got {values.shape}")
    if not np.isfinite(values).all():
        index = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ValueError(f"{name}[{index}] is {values[index]}; values must be finite")


def _check_result(name: str, values: np.ndarray) -> None:
    within = np.abs(values.reshape(-1)) <= LARGEST
    if not within.all():
        bad = int(within.argmin())
        raise ValueError(f"{name}[{bad}] is {values.reshape(-1)[bad]}; every value must be finite and within +-1e6")


def _check_out(out: np.ndarray, vertex_count: int) -> None:
    if not isinstance(out, np.ndarray) or out.dtype != np.float32 or out.ndim != 2 or not out.flags.writeable:
        got = f"{out.dtype} of shape {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        raise TypeError(f"out must be a float32 array, writable and 2-D; got {got}")
    if out.shape not in ((vertex_count, 3), (vertex_count, 6)):
        raise ValueError(f"out has shape {out.shape}; expected ({vertex_count}, 3) or ({vertex_count}, 6)")
    if out.strides[1] != out.itemsize:
        raise ValueError("a row of out must be contiguous; rows may be any distance apart")
    if vertex_count > 1 and abs(out.strides[0]) < out.shape[1] * out.itemsize:
        raise ValueError(f"rows of out overlap: they are {out.strides[0]} bytes apart")
