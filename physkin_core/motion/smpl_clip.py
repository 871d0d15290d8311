"""Clips of SMPL's body models, from AMASS and alike: .npz files of joint rotations, without a body.

SMPL, SMPL-H and SMPL-X have their first 22 joints in common. The rest stands in for a body of medium build: only how
long its legs are counts, by which the way is scaled. Dimensions: `T` frames.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError, listed
from physkin_core.formats.npz_file import read_npz
from physkin_core.motion.source_clip import SourceClip, check_clip_size, posed_clip

__all__ = ["read_smpl_clip"]

log = logging.getLogger(__name__)

JOINTS = """
pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot neck
left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist""".split()
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
TRUNK = {"spine1": (0, 0.11, -0.02), "spine2": (0, 0.13, 0), "spine3": (0, 0.06, 0.02), "neck": (0, 0.21, -0.04)}
TRUNK |= {"head": (0, 0.1, 0.05)}
LIMBS = {"hip": (0.07, -0.09, -0.01), "knee": (0.01, -0.39, 0), "ankle": (0.01, -0.41, -0.03)}
LIMBS |= {"foot": (0.03, -0.05, 0.12), "collar": (0.07, 0.12, -0.02), "shoulder": (0.11, 0.03, -0.01)}
LIMBS |= {"elbow": (0.26, 0, 0), "wrist": (0.25, 0, 0)}
"""Metres from the parent in SMPL's T-pose, Y up, facing Z; of the left limb. Knees are not to the side of the way from
hip to ankle, as what bends there would be taken for the axis of the knee."""
ANGLES = ("poses", "pose", "fullpose"), ("root_orient", "global_orient"), ("pose_body", "body_pose")
PLACES, RATES = ("trans", "transl"), ("mocap_framerate", "mocap_frame_rate", "fps")
USUAL_HZ, MOST_ANGLE = 30.0, 4 * np.pi
UPRIGHT = 0.7
"""Mean cosine between the trunk and the file's Y axis from which on that is up, or down; else it is Z, as in AMASS."""


def read_smpl_clip(path: Path) -> SourceClip:
    """Read a .npz with `poses`, axis and angle of each joint in SMPL's order (T, 66 or more), or with `root_orient` and
    `pose_body`; places `trans` (T, 3) and the rate may be missing. Raises ContentError, and what `read_npz` raises."""
    arrays = read_npz(path)
    numbers = {name: array for name, array in arrays.items() if array.dtype.kind in "iuf"}
    whole, root, body, places, rate = (
        next((numbers[name] for name in names if name in numbers), None) for names in (*ANGLES, PLACES, RATES)
    )
    parts = [part for part in ((root, body) if whole is None else (whole,)) if part is not None and part.ndim > 1]
    if len(parts) < 1 + (whole is None):
        raise ContentError(
            f"it has {listed(arrays)}; a clip has poses, or root_orient and pose_body, of numbers; landmarks are points"
        )
    count, width = len(parts[0]), 3 * len(JOINTS)
    places = np.zeros((count, 3)) if places is None else places
    parts = [_angles(part) for part in parts]
    if {len(part) for part in parts} != {count} or sum(part.shape[1] for part in parts) < width:
        shapes = ", ".join(str(part.shape) for part in parts)
        raise ContentError(f"its rotations are {shapes}; allowed are {width} angles or more for each frame")
    turns = np.concatenate(parts, axis=1)[:, :width].astype(np.float64)
    if count == 0 or places.shape != (count, 3) or not (np.isfinite(turns).all() and np.isfinite(places).all()):
        raise ContentError(f"its rotations and places, {count} and {places.shape}, must be as many, some, and finite")
    rate_hz = float(rate.item()) if rate is not None and rate.size == 1 and 0 < rate < np.inf else 0.0
    if not rate_hz:
        rate_hz = USUAL_HZ
        log.warning("%s states no rate: %g Hz is assumed; source_rate_hz (--source-rate) sets it", path, USUAL_HZ)
    check_clip_size(count, len(JOINTS), rate_hz)
    on_parent = [Rotation.from_rotvec(turn) for turn in turns.reshape(count, -1, 3).transpose(1, 0, 2)]
    upright = float(on_parent[0].apply([0.0, 1.0, 0.0])[:, 1].mean())
    to_y_up = Rotation.from_euler("x", -90 if abs(upright) < UPRIGHT else 90 - 90 * np.sign(upright), degrees=True)
    if abs(upright) >= UPRIGHT:
        said = "%s: up is taken to be %s, along which the body stands; AMASS has Z"
        log.warning(said, path, "Y" if upright > 0 else "-Y")
    on_parent[0], places = to_y_up * on_parent[0], to_y_up.apply(places)
    offsets = np.array([_offset(name) for name in JOINTS])
    return posed_clip(JOINTS, PARENTS, offsets, on_parent, {0: places}, count, rate_hz)


def _angles(part: np.ndarray) -> np.ndarray:
    """(T, 3 J) of axes and angles, or of matrices (T, J, 3, 3). Raises ContentError for other rotations."""
    if part.shape[-2:] == (3, 3) and np.allclose(part @ part.swapaxes(-1, -2), np.eye(3), atol=0.01):
        return Rotation.from_matrix(part.reshape(-1, 3, 3)).as_rotvec().reshape(len(part), -1)
    if (part.ndim > 2 and part.shape[-1] != 3) or np.nanmax(np.abs(part), initial=0) > MOST_ANGLE:
        raise ContentError(f"its rotations {part.shape} are not axes and angles in radians; convert them")
    return part.reshape(len(part), math.prod(part.shape[1:]))


def _offset(joint: str) -> tuple[float, float, float]:
    """From the parent at rest [m]."""
    side, _, part = joint.partition("_")
    x, y, z = LIMBS.get(part) or TRUNK.get(joint, (0.0, 0.0, 0.0))
    return (-x if side == "right" else x), y, z
