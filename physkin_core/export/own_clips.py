"""Clips in an avatar's own file as motion of the garments' rig: it drives the cloth, while the file's joints stay.

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
"""How much a turn of these counts, which must not drag along limb or trunk; 1 is usual."""


def carriers(avatar: Avatar, rig: Rig) -> np.ndarray:
    """(b,) for each bone the one whose joint in the file moves the skin there: itself, the nearest above that has one,
    or else the first that has one."""
    own = np.flatnonzero(avatar.file_joints >= 0)
    return rig.inherited({int(bone): int(bone) for bone in own}, int(own[0]))


def own_motion(file: GltfFile, avatar: Avatar, rig: Rig, clip: GltfClip, seconds: np.ndarray) -> Motion:
    """How the rig moves where the clip moves the file's joints, at evenly spaced times (T,) [s]. Raises ContentError,
    and MotionError for what is not finite."""
    bones = np.unique(carriers(avatar, rig))
    joints, names = avatar.file_joints[bones], {rig.bone_names[bone] for bone in bones}
    inside = {above for joint in joints for above in ancestors(file.node_parents, joint)}
    nodes = [node for node in file.node_order if node in inside]
    worlds = dict(zip(nodes, clip.worlds(nodes, seconds)))
    moved = np.stack([worlds[joint] for joint in joints], axis=1) @ np.linalg.inv(avatar.file_joint_frames[bones])
    root, linear = moved[:, 0], moved[..., :3, :3]
    unit = np.cbrt(np.median(np.linalg.det(linear[:, 0])))  # the scene's, a metre
    follows = np.flatnonzero(np.isin(rig.turns_with[bones], rig.dof_bones) & (bones != bones[0]))
    axes = np.stack([LIGHT.get(rig.bone_names[bone].split(".")[0], 1.0) * np.eye(3) for bone in bones[follows]])
    solver = PoseSolver(rig, [covered_bones(int(bone), rig, names)[-1] for bone in bones[follows]], axes)
    turned = _turns(np.linalg.pinv(linear[:, :1]) @ linear[:, follows]).as_matrix()
    return Motion(
        rig.joint_names,
        solver.solve(turned.reshape(-1, *axes.shape) @ axes),
        _turns(FROM_ROOT_FRAME.T @ linear[:, 0] / unit).as_quat(),
        root[:, :3, 3] @ FROM_ROOT_FRAME / unit,
        rate_hz=(len(seconds) - 1) / (seconds[-1] - seconds[0]) if len(seconds) > 1 else 1.0,
    )


def _turns(linear: np.ndarray) -> Rotation:
    """Rotations of linear maps (..., 3, 3), all in one list; none of what is scaled to nothing."""
    linear = linear.reshape(-1, 3, 3)
    size = np.cbrt(np.linalg.det(linear))[:, None, None]
    return Rotation.from_matrix(np.where(size > 1e-3, linear / np.maximum(size, 1e-3), np.eye(3)))
