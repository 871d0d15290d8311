"""Bones in a pose, and the pose as the networks see it."""

import numpy as np


def rotation_about(axis, angle):
    """Rodrigues' formula: rotation (3, 3) by `angle` [rad] about a unit axis (3,)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def bone_transforms(parents, heads, dof_bone, dof_axis, angles):
    """(b, 3, 4) from the canonical pose of bones at heads (b, 3), which joints turn by angles (d,) from rest."""
    heads, axes = heads.astype(np.float64), dof_axis.astype(np.float64)
    rotations, places = [], []
    for bone, parent in enumerate(parents):
        turn, place = np.eye(3), heads[bone]
        for joint in np.flatnonzero(dof_bone == bone):
            turn = turn @ rotation_about(axes[joint], angles[joint])
        if parent >= 0:
            place = places[parent] + rotations[parent] @ (heads[bone] - heads[parent])
            turn = rotations[parent] @ turn
        rotations.append(turn)
        places.append(place)
    return np.stack([np.c_[turn, place - turn @ head] for turn, place, head in zip(rotations, places, heads)])


def pose_vector(positions, lower, upper, gravity):
    """theta (d + 3,): joint positions scaled to [-1, 1] by their limits and clipped, then effective gravity (3,)."""
    lower, upper = lower.astype(np.float64), upper.astype(np.float64)
    return np.r_[np.clip((positions - (lower + upper) / 2) / ((upper - lower) / 2), -1, 1), gravity]
