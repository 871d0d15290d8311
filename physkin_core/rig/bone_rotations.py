"""Joint positions of the rig from rotations of bones, as quaternions.

Dimensions: `d` degrees of freedom, `b` bones of the rig, `k` bones that rotations are given of. Radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches

import numpy as np

from physkin_core.rig.ball_joints import BallJoint, BallRotations
from physkin_core.rig.rig import Rig, RigError
from physkin_core.rig.vrm_bones import VRM_AXES, rig_ball_joint, vrm_ball_joints

__all__ = ["SKELETONS", "BoneRotations"]

SKELETONS = ("rig", "vrm")
NORM_TOLERANCE = 1e-3
"""By which a quaternion's length may differ from 1."""
NEGLIGIBLE = 1e-12  # [rad] an angle of this size is rounding of zero


class BoneRotations:
    """Splits rotations of bones into the joint positions of a rig.

    A rotation becomes rotations about the bone's joints, in their order; what the bone has no joint for is left out.
    Positions are not clipped to the rig's limits: the networks see them clipped, but bones turn by them as they are.
    For the default rig, joint positions within its limits that are turned into rotations and back stay the same, to
    single precision.

    Args:
        rig: the rig.
        skeleton: whose bones are rotated. "rig": the rig's own; a rotation is relative to the parent and to the
            canonical pose. In that pose the axes of every bone are those of the root frame (X forward, Y left, Z up).
            "vrm": VRM's humanoid bones, relative to the parent and to the T-pose, in VRM's axes; only for the default
            rig.

    Attributes:
        bone_names: (k,) bones that may be given.

    Raises:
        RigError: for an unknown skeleton, and for a rig with joints of one bone that are not at right angles.

    Examples:
        >>> rotations = physkin.BoneRotations(physkin.load_garment_model("tshirt").rig)
        >>> rotations.joint_positions({"upperarm01.L": (0.0, 0.0, 0.259, 0.966)}).shape
        (52,)
    """

    def __init__(self, rig: Rig, *, skeleton: str = "rig") -> None:
        if skeleton not in SKELETONS:
            raise RigError(f"unknown skeleton {skeleton!r}; allowed: {', '.join(SKELETONS)}")
        self._rig, self._axes = rig, np.eye(3)
        if skeleton == "rig":
            balls = _own_ball_joints(rig)
            self.bone_names = rig.bone_names
        else:
            try:
                balls = vrm_ball_joints(rig)
            except ValueError as error:
                raise RigError(f"bones of VRM are for the default rig: {error}") from error
            self._axes = VRM_AXES.T  # from VRM's axes to the root frame's
            self.bone_names = ("hips", *balls)
        self._row = dict.fromkeys(self.bone_names, -1) | {bone: row for row, bone in enumerate(balls)}
        self._count = len(balls)
        self._solver = BallRotations(list(balls.values()), rig.joint_indices)

    def joint_positions(
        self, rotations: Mapping[str, Sequence[float]] | np.ndarray, *, start: np.ndarray | None = None
    ) -> np.ndarray:
        """Joint positions for rotations of bones.

        Args:
            rotations: unit quaternions (x, y, z, w) by bone; or (k, 4) in the order of `bone_names`.
            start: (d,) [rad], positions of the bones that are left out. None: at rest.

        Returns:
            (d,) float64 [rad], in the rig's order.

        Raises:
            RigError: naming an unknown bone, or a quaternion that is not finite or not of length 1.
        """
        if not isinstance(rotations, Mapping):
            given = np.asarray(rotations, dtype=np.float64)
            if given.shape != (len(self.bone_names), 4):
                raise RigError(f"bone rotations have shape {given.shape}, expected ({len(self.bone_names)}, 4)")
            rotations = dict(zip(self.bone_names, given))
        if unknown := self.unknown_bones(rotations):
            close = ", ".join(get_close_matches(str(unknown[0]), self.bone_names, cutoff=0.4))
            raise RigError(
                f"no bone {unknown[0]!r}; {f'did you mean {close}?' if close else ', '.join(self.bone_names)}"
            )
        rows = np.array([self._row[bone] for bone in rotations], dtype=np.intp)
        turns = self._axes @ _matrices(rotations) @ self._axes.T
        every = np.tile(np.eye(3), (self._count, 1, 1))
        every[rows[rows >= 0]] = turns[rows >= 0]
        solved = np.zeros(len(self._rig.dofs))
        self._solver.solve(every, solved)
        solved[np.abs(solved) < NEGLIGIBLE] = 0.0
        positions = np.array(self._rig.rest if start is None else start, dtype=np.float64)
        named = self._solver.targets[np.isin(self._solver.owners, rows)]
        positions[named] = self._rig.rest[named] + solved[named]
        return positions

    def unknown_bones(self, names: Iterable[str]) -> list[str]:
        """Those of the names that are not bones."""
        return [name for name in names if name not in self._row]


def _own_ball_joints(rig: Rig) -> dict[str, BallJoint]:
    """The ball joint of each bone that has joints."""
    joints: dict[str, list[str]] = {}
    for dof in rig.dofs:
        joints.setdefault(dof.bone, []).append(dof.name)
    for bone, names in joints.items():
        axes = rig.dof_axes[[rig.joint_names.index(name) for name in names]]
        if np.abs(axes @ axes.T - np.eye(len(axes))).max() > 1e-6:
            raise RigError(f"joints {', '.join(names)} of bone {bone!r} turn about axes that are not at right angles")
    return {bone: rig_ball_joint(rig, names) for bone, names in joints.items()}


def _matrices(rotations: Mapping[str, Sequence[float]]) -> np.ndarray:
    """(k, 3, 3) of checked quaternions."""
    from scipy.spatial.transform import Rotation

    for bone, value in rotations.items():
        quaternion = np.asarray(value, dtype=np.float64)
        if quaternion.shape != (4,) or not abs(np.linalg.norm(quaternion) - 1) <= NORM_TOLERANCE:
            raise RigError(
                f"the rotation of bone {bone!r} is {quaternion.tolist()}; expected a quaternion x, y, z, w of length 1"
            )
    if not rotations:
        return np.empty((0, 3, 3))
    return Rotation.from_quat(np.array(list(rotations.values()), dtype=np.float64)).as_matrix()
