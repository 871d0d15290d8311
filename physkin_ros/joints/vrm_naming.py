"""Joint states that carry the humanoid bones of VRM: three angles a bone, `leftUpperArm_x`, `_y` and `_z`.

Angles [rad] are those of VRM 1.0's normalised bones: zero is the T-pose, every bone's axes are the model's own there
(X to its left, Y up, Z forward), and a bone turns about its X, then Y, then Z (intrinsic), three.js's default order.
`hips` is not read: it places the root, whose tilt is the orientation source's to give.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from physkin_core import Rig
from physkin_core.rig.canonical_pose import limb_rotations
from physkin_ros.joints.ball_joints import BallJoint
from physkin_ros.joints.joint_states import JointStateError, NamedJoints

__all__ = ["VRM", "VrmNaming"]

VRM = "vrm"
"""What the parameter `joint_map` calls this naming."""

VRM_AXES = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""VRM's X, Y and Z in the root frame (X forward, Y left, Z up)."""
TRUNK = {"spine": "spine05", "chest": "spine03", "upperChest": "spine02", "neck": "neck01", "head": "head"}
# Humanoid bone -> rig bone and axes of its joints in the rig's order, the rig bone that shares the twist, and whether
# T-pose alignments are those of the limb above and of its own.
LIMBS = {
    "Shoulder": ("clavicle", "xz", None, (None, None)),
    "UpperArm": ("upperarm01", "xyz", "upperarm02", (None, "upperarm01")),
    "LowerArm": ("lowerarm01", "z", "lowerarm02", ("upperarm01", "lowerarm01")),
    "Hand": ("wrist", "xz", None, ("lowerarm01", "lowerarm01")),
    "UpperLeg": ("upperleg01", "yxz", "upperleg02", (None, "upperleg01")),
    "LowerLeg": ("lowerleg01", "y", None, ("upperleg01", "lowerleg01")),
    "Foot": ("foot", "yz", None, ("lowerleg01", None)),  # flat on the floor in both poses
}


class VrmNaming:
    """Names `BONE_x`, `BONE_y`, `BONE_z` of VRM humanoid bones; the rig's own names mean themselves.

    Of a bone, angles that are not named count as zero. Raises ValueError for a rig that lacks a default rig's joint.
    """

    def __init__(self, rig: Rig) -> None:
        self._own = frozenset(rig.joint_names)
        try:
            self._bones = {bone: _ball(rig, [f"{target}_{axis}" for axis in "xyz"]) for bone, target in TRUNK.items()}
            for side, letter in (("left", "L"), ("right", "R")):
                aligned = _t_pose(rig, letter)
                for bone, (target, axes, second, (above, own)) in LIMBS.items():
                    joints = [f"{target}.{letter}_{axis}" for axis in axes]
                    if second and len(axes) == 1:  # a hinge, and the rest of the limb twists
                        joints.append(f"{second}.{letter}_y")
                    half = f"{second}.{letter}_{'y' if 'Arm' in bone else 'z'}" if second and len(axes) == 3 else ""
                    before, after = aligned.get(above, np.eye(3)).T, aligned.get(own, np.eye(3))
                    self._bones[side + bone] = _ball(rig, joints, half=half, before=before, after=after)
        except ValueError as error:
            raise ValueError(f"joint_map {VRM} is for the default rig: {error}") from error
        self._pattern = re.compile(rf"({'|'.join(self._bones)})[_.]([xyz])")

    def look_up(self, names: Sequence[str]) -> NamedJoints:
        """See `JointNaming`. Raises JointStateError for an angle named twice."""
        found = NamedJoints()
        angles: dict[str, list[int]] = {}
        for index, name in enumerate(names):
            if match := self._pattern.fullmatch(name):
                slots = angles.setdefault(match[1], [-1, -1, -1])
                slot = "xyz".index(match[2])
                if slots[slot] >= 0:
                    raise JointStateError(f"joints {names[slots[slot]]!r} and {name!r} are the same angle")
                slots[slot] = index
            elif name in self._own:
                found.scaled.append((index, name, 1.0, 0.0))
            else:
                found.unknown.append(index)
        found.balls = [(self._bones[bone], tuple(slots)) for bone, slots in angles.items()]
        return found


def _ball(
    rig: Rig, joints: list[str], *, half: str = "", before: np.ndarray | None = None, after: np.ndarray | None = None
) -> BallJoint:
    axes = [rig.dof_axes[rig.joint_names.index(joint)] for joint in joints]
    if len(axes) == 1:
        axes.append(np.cross(axes[0], np.eye(3)[np.argmin(np.abs(axes[0]))]))
        axes[1] /= np.linalg.norm(axes[1])
    if len(axes) == 2:
        axes.append(np.cross(axes[0], axes[1]))
    twist = next((slot for slot, joint in enumerate(joints) if half and joint[-1] == half[-1]), None)
    names = (*joints, *[""] * (3 - len(joints)))
    return BallJoint(
        axes=VRM_AXES,
        before=np.eye(3) if before is None else before,
        after=np.eye(3) if after is None else after,
        frame=np.stack(axes, axis=1),
        joints=(*names, half) if half else names,
        twist=twist,
    )


def _t_pose(rig: Rig, side: str) -> dict[str, np.ndarray]:
    """By limb bone (without its side), the rotation (3, 3) that takes it from the canonical pose to the T-pose."""
    heads = {name: head for name, head in zip(rig.bone_names, rig.heads) if name.endswith(f".{side}")}
    out = np.array([0.0, 1.0 if side == "L" else -1.0, 0.0])
    stretched = dict(heads)
    for chain, way in (
        (("upperarm01", "lowerarm01", "wrist"), out),
        (("upperleg01", "lowerleg01", "foot"), -np.eye(3)[2]),
    ):
        for above, below in zip(chain, chain[1:]):
            length = np.linalg.norm(heads[f"{below}.{side}"] - heads[f"{above}.{side}"])
            stretched[f"{below}.{side}"] = stretched[f"{above}.{side}"] + length * way
    turns = limb_rotations(heads, stretched)
    return {bone.removesuffix(f".{side}"): turn for bone, turn in turns.items()}
