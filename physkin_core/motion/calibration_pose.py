"""The calibration pose that a motion capture file may open with, found limb by limb.

Some files begin with a frame or more in which the whole body, or only an arm, holds the pose of its calibration. From
there it jumps to the motion, at once or blended over a few frames, faster than a body leaves a pose that it holds.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.motion.source_clip import SourceClip

__all__ = ["calibration_frames"]

LIMBS = {
    "trunk": (None, ("root", "chest", "neck")),
    "left arm": ("chest", ("shoulder.L", "elbow.L")),
    "right arm": ("chest", ("shoulder.R", "elbow.R")),
    "left leg": ("root", ("hip.L", "knee.L")),
    "right leg": ("root", ("hip.R", "knee.R")),
}
"""What carries a limb (None: the world), and its joints. Hands and feet are left out: they flip in motion, too."""
LONGEST = 2.0  # [s] that a calibration pose is held
HELD = 0.1  # [rad] that a joint stays within while it holds a pose
JUMP_SPEED = np.radians(2000)  # [rad/s] with which a joint leaves a calibration pose, and sets out from no other
JUMP_STEPS = 3  # from the first out of the pose on; one of them is as fast as that
BLEND_STEPS = 8  # a jump is blended into the motion over at most as many
CALM_SPEED = np.radians(120)  # [rad/s] up to which a step is motion, however still the joint is afterwards


def calibration_frames(source: SourceClip, joints: Mapping[str, int]) -> tuple[int, list[str]]:
    """How many frames calibration poses take, those that blend into the motion included, and which limbs hold them.

    joints: index of each joint named in `LIMBS`.
    """
    opening = source.at(slice(round(LONGEST * source.rate_hz) + 3 * BLEND_STEPS))
    rotations = {part: opening.turned(joints[part]) for _, parts in LIMBS.values() for part in parts}
    speeds, ends = [], {}
    for limb, (carrier, parts) in LIMBS.items():
        carried_by = rotations[carrier].inv() if carrier else Rotation.identity(opening.frame_count)
        for part in parts:
            turn = carried_by * rotations[part]
            speed = (turn[:-1].inv() * turn[1:]).magnitude() * source.rate_hz
            first_out = int(((turn[0].inv() * turn).magnitude() > HELD).argmax())
            if first_out and speed[first_out - 1 :][:JUMP_STEPS].max() > JUMP_SPEED:
                ends[limb] = max(first_out, ends.get(limb, 0))
            speeds.append(speed)
    end = max(ends.values(), default=0)
    if not 0 < end < opening.frame_count - 1 - BLEND_STEPS:
        return 0, []
    return end + max(_blended(speed[end:]) for speed in speeds), list(ends)


def _blended(speeds: np.ndarray) -> int:
    """Steps after a jump, up to the last that is twice as fast as all that follows the blending."""
    later = speeds[BLEND_STEPS : 3 * BLEND_STEPS].max()
    fast = np.flatnonzero(speeds[:BLEND_STEPS] > max(2 * later, CALM_SPEED))
    return int(fast[-1]) + 1 if len(fast) else 0
