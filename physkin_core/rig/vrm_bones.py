"""VRM's humanoid bones as ball joints of the default rig.

A rotation is that of VRM 1.0's normalised bones: relative to its parent, from the T-pose, in the model's axes, which
every bone has there. `hips` is left out: it places the root, whose tilt the direction of gravity tells.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from physkin_core.rig.ball_joints import BallJoint
from physkin_core.rig.canonical_pose import t_pose_rotations
from physkin_core.rig.rig import Rig

__all__ = ["HUMANOID_BONES", "VRM_AXES", "ball_entry", "rig_ball_joint", "vrm_ball_joints", "vrm_bone_table"]

VRM_AXES = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""VRM's X, Y and Z in the root frame (X forward, Y left, Z up)."""
HUMANOID_BONES = {"hips": "root", "spine": "spine04", "chest": "spine02", "upperChest": "spine01"}
HUMANOID_BONES |= {"neck": "neck01", "head": "head"}
"""Rig bone at which each humanoid bone begins; the limbs follow below."""
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
for _side in ("left", "right"):
    HUMANOID_BONES |= {_side + bone: f"{target}.{_side[0].upper()}" for bone, (target, *_) in LIMBS.items()}


def vrm_ball_joints(rig: Rig) -> dict[str, BallJoint]:
    """The ball joint of each humanoid bone. Raises ValueError for a rig that lacks a default rig's joint."""
    bones = {bone: rig_ball_joint(rig, [f"{target}_{axis}" for axis in "xyz"]) for bone, target in TRUNK.items()}
    aligned_limbs = t_pose_rotations(dict(zip(rig.bone_names, rig.heads)))
    for side, letter in (("left", "L"), ("right", "R")):
        aligned = {bone.removesuffix(f".{letter}"): turn for bone, turn in aligned_limbs.items() if bone[-1] == letter}
        for bone, (target, axes, second, (above, own)) in LIMBS.items():
            joints = [f"{target}.{letter}_{axis}" for axis in axes]
            if second and len(axes) == 1:  # a hinge, and the rest of the limb twists
                joints.append(f"{second}.{letter}_y")
            half = f"{second}.{letter}_{'y' if 'Arm' in bone else 'z'}" if second and len(axes) == 3 else ""
            before, after = aligned.get(above, np.eye(3)).T, aligned.get(own, np.eye(3))
            bones[side + bone] = rig_ball_joint(rig, joints, half=half, before=before, after=after)
    return bones


def vrm_bone_table(rig: Rig) -> dict[str, str]:
    """As `vrm_bones`, JSON text, how hosts without Python take a pose of VRM's humanoid bones apart: by bone, rotations
    `before` and `after`, row by row, between which a rotation in VRM's axes is one about the rig's axes; `joints` that
    turn by its three angles about X, Y and Z, "" for none, times `sign`; and, where `twist` is not -1, a fourth joint
    that takes half of that angle. Nothing for a rig that is not the default one. native/web/vrm.js reads it."""
    try:
        balls = vrm_ball_joints(rig)
    except ValueError:
        return {}
    table = {bone: ball_entry(ball, VRM_AXES) for bone, ball in balls.items()}
    return {"vrm_bones": json.dumps(table, separators=(",", ":"))}


def ball_entry(ball: BallJoint, axes: np.ndarray) -> dict[str, Any]:
    """A ball joint as `vrm_bone_table` has it. axes: (3, 3) rows are those of its rotations, in the root frame."""
    return {
        "before": (ball.frame.T @ ball.before @ axes.T).round(7).ravel().tolist(),
        "after": (axes @ ball.after @ ball.frame).round(7).ravel().tolist(),
        "joints": list(ball.joints),
        "sign": int(np.sign(np.linalg.det(ball.frame))),
        "twist": -1 if ball.twist is None else ball.twist,
    }


def rig_ball_joint(
    rig: Rig, joints: list[str], *, half: str = "", before: np.ndarray | None = None, after: np.ndarray | None = None
) -> BallJoint:
    """One to three joints of the rig, with axes at right angles, as a ball joint.

    half: the joint that takes half of the twist. before, after: as of `BallJoint`, default none.
    """
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
