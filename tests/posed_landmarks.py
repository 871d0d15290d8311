"""Landmarks of the default rig's own body in motion: what an ideal tracker would give, in a camera's axes."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core import load_motion
from physkin_core.motion.landmarks import LANDMARK_SETS, USED
from physkin_core.rig.joint_names import plain_name

RATE_HZ = 30.0
NAMES = LANDMARK_SETS["mediapipe"]["names"].split()

CAMERA = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
"""A camera's x (right), y (down) and z (away) of a person who looks at it, from X forward, Y left, Z up."""
JOINTS = {"shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist"}
JOINTS |= {"hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot"}
ON_LEFT = {
    "eye": [0.13, 0.032, 0.705],
    "ear": [0.04, 0.08, 0.68],
    "heel": [-0.056, 0.19, -0.884],
    "toe": [0.2, 0.17, -0.904],
}
"""[m] of the body that garments were made on, in the canonical pose."""
SEGMENTS = {"upper arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"), "thigh": ("hip", "knee")}
SEGMENTS |= {"shin": ("knee", "ankle"), "foot": ("heel", "toe")}
ROW = {name: row for row, name in enumerate(USED)}


def landmarks_of(rig, positions, root):
    """Places (T, 21, 3) [m] in the world of `USED`, for joint positions (T, d) and roots (T, 7)."""
    transforms, turn = rig.bone_transforms(positions), Rotation.from_quat(root[:, 3:])
    places = []
    for name in USED:
        part, side = name.split(".")
        if part in JOINTS:
            bone = f"{JOINTS[part]}.{side}"
            at = rig.heads[rig.bone_index(bone)]
        else:
            bone = f"foot.{side}" if part in ("heel", "toe") else "head"
            at = (
                np.array([0.161, 0, 0.664])
                if part == "nose"
                else ON_LEFT[part] * np.array([1, 1 - 2 * (side == "R"), 1])
            )
        moved = transforms[:, rig.bone_index(bone)]
        places.append(turn.apply(moved[:, :, :3] @ at + moved[:, :, 3]) + root[:, :3])
    return np.stack(places, axis=1)


def angles_between(seen, truth, segments=SEGMENTS):
    """Angles (T, 2) [degrees] between limbs of two sets of landmarks, left and right, by segment."""
    found = {}
    for segment, (start, end) in segments.items():
        ends = [[ROW[f"{part}.{side}"] for side in "LR"] for part in (start, end)]
        along = [at[:, ends[1]] - at[:, ends[0]] for at in (seen, truth)]
        cosine = (along[0] * along[1]).sum(axis=-1) / np.prod([np.linalg.norm(each, axis=-1) for each in along], axis=0)
        found[segment] = np.degrees(np.arccos(cosine.clip(-1, 1)))
    return found


def clip_of(rig, name):
    """Joint positions, roots and landmarks in the world, at 30 Hz."""
    motion = load_motion(name).resampled(RATE_HZ)
    positions, root = motion.positions_for(rig), motion.root.astype(np.float64)
    return positions, root, landmarks_of(rig, positions, root)


def in_order(landmarks, names):
    """Landmarks (T, 21, 3) as a tracker lists them, NaN where we have none."""
    found = np.full((len(landmarks), len(names), 3), np.nan)
    aliases = {"footindex": "toe", "bigtoe": "toe", "foot": "toe"}
    for column, name in enumerate(names):
        part, side = plain_name(name).split(".")
        if (ours := f"{aliases.get(part, part)}.{side}") in USED:
            found[:, column] = landmarks[:, USED.index(ours)]
    return found


def read_all(reader, points, rate_hz=RATE_HZ):
    """Joint positions and roots of all frames."""
    read = [reader.read(each, time_s=frame / rate_hz) for frame, each in enumerate(points)]
    return tuple(np.array(part) for part in zip(*read))


def medians(rig, read, truth):
    return {segment: np.median(angle) for segment, angle in angles_between(landmarks_of(rig, *read), truth).items()}
