"""Clips in an avatar's own file as motion of the garments' rig, which only drives the cloth: the file's joints stay.

Dimensions: `T` frames, `b` bones, `k` of them with a joint in the file.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.retargeting import covered_bones
from physkin_core.export.gltf_builder import FROM_ROOT_FRAME
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.motion.gltf_clip import GltfClip
from physkin_core.motion.motion import Motion
from physkin_core.motion.pose_solver import PoseSolver
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["carriers", "own_motion"]

LIGHT = {"foot": 0.15, "wrist": 0.15, "neck01": 0.15, "head": 0.15}
"""How much the turn of these bones counts, which must not drag along the limb or the trunk; 1 is usual."""
BLOCK = 1024
"""Frames posed together, which bounds the memory."""


def carriers(avatar: Avatar, rig: Rig) -> np.ndarray:
    """(b,) for each bone the one whose joint in the file moves the skin there: itself, or the nearest above that has
    one; the first that has one for those above all."""
    own = np.flatnonzero(avatar.file_joints >= 0)
    return rig.inherited({int(bone): int(bone) for bone in own}, int(own[0]))


def own_motion(
    file: GltfFile, avatar: Avatar, rig: Rig, clip: GltfClip, seconds: np.ndarray, *, name: str = ""
) -> Motion:
    """How the rig moves as the clip moves the file's joints, at evenly spaced times (T,) [s].

    Raises ContentError, and MotionError for what is not finite.
    """
    bones = np.unique(carriers(avatar, rig))
    joints = avatar.file_joints[bones]
    inside = {above for joint in joints for above in ancestors(file.node_parents, joint)}
    nodes = [node for node in file.node_order if node in inside]
    place = [nodes.index(joint) for joint in joints]
    moved = np.empty((len(seconds), len(bones), 4, 4))
    for frames in np.array_split(np.arange(len(seconds)), -(-len(seconds) // BLOCK)):
        worlds = list(clip.worlds(nodes, seconds[frames]))
        for k, frame in enumerate(np.linalg.inv(avatar.file_joint_frames[bones])):
            moved[frames, k] = worlds[place[k]] @ frame
    root, unit = moved[:, 0], float(np.cbrt(np.median(np.abs(np.linalg.det(moved[:, 0, :3, :3])))))
    relative = np.linalg.pinv(root[:, None, :3, :3]) @ moved[..., :3, :3]

    follows = np.isin(rig.turns_with[bones], rig.dof_bones) & (bones != bones[0])
    shares = [LIGHT.get(rig.bone_names[bone].split(".")[0], 1.0) for bone in bones[follows]]
    axes = np.array(shares)[:, None, None] * np.eye(3)
    named = {rig.bone_names[bone] for bone in bones}
    solver = PoseSolver(rig, [covered_bones(int(bone), rig, named)[-1] for bone in bones[follows]], axes)
    return Motion(
        rig.joint_names,
        solver.solve(_turns(relative[:, follows]).as_matrix().reshape(len(seconds), -1, 3, 3) @ axes),
        _turns(FROM_ROOT_FRAME.T @ root[:, :3, :3] / (unit or 1.0)).as_quat(),
        root[:, :3, 3] @ FROM_ROOT_FRAME / (unit or 1.0),
        rate_hz=(len(seconds) - 1) / (seconds[-1] - seconds[0]) if len(seconds) > 1 else 1.0,
        name=name,
    )


def _turns(linear: np.ndarray) -> Rotation:
    """Rotations of linear maps (..., 3, 3), all in one list; none of what is scaled to nothing."""
    linear = linear.reshape(-1, 3, 3).copy()
    linear[np.linalg.det(linear) < 1e-9] = np.eye(3)
    return Rotation.from_matrix(linear / np.cbrt(np.linalg.det(linear))[:, None, None])
