"""Whether a motion is as fast as people are: where its file has the wrong rate, steps are too slow or too quick for
their length.

People who walk, and those who run, take longer steps the quicker they step: length over steps a second is some 0.4 m s
for all of them, 0.25 at a run, where both feet are off the ground on the way. Dimensions: `T` frames.
"""

from __future__ import annotations

import numpy as np

from physkin_core.motion.motion import Motion
from physkin_core.rig.rig import Rig

__all__ = ["doubtful_pace"]

STRIDE = 0.3
"""[m] that feet are apart at least, along the way, at each end of what counts as a step."""
LONGEST_STEP = 3.0
"""[s]; whoever takes longer stands in between."""
WALKING = 0.4
"""Share of a clip that steps take where its pace is judged."""
STEADY = 0.3
"""Least median of how fast the feet pass each other, over nearly the fastest: of who walks or runs, not of who steps
and stands, as in dances and fights. A sine has 0.7."""
STEP_RATIOS = (0.12, 0.75)
"""[m s] of step length over steps a second: half of a run's, twice that of a walk."""


def doubtful_pace(motion: Motion, rig: Rig) -> str:
    """A sentence for a motion whose steps are slower or quicker than anybody's; "" for all others.

    motion: of the rig's joints, standing.
    """
    ankles = [rig.bone_index(f"foot.{side}") for side in "LR"]
    heads = np.append(rig.heads[ankles], np.ones((2, 1)), axis=1)
    transforms = rig.bone_transforms(motion.positions)[:, ankles]
    left, right = np.einsum("tkij,kj->kti", transforms, heads)
    ahead = (left - right)[:, 0]
    side = np.where(np.abs(ahead) > STRIDE / 2, np.sign(ahead), 0)
    frames = np.flatnonzero(side)
    steps = frames[1:][np.diff(side[frames]) != 0]  # in which the other foot is ahead
    seconds = np.diff(steps) / motion.rate_hz
    seconds = seconds[seconds < LONGEST_STEP]
    passing = np.abs(np.diff(ahead, prepend=ahead[0]))
    steady = np.median(passing) > STEADY * np.quantile(passing, 0.95)
    if len(seconds) == 0 or not steady or seconds.sum() < WALKING * motion.frame_count / motion.rate_hz:
        return ""
    length, each = float(np.ptp(np.quantile(ahead, [0.05, 0.95]))) / 2, float(np.median(seconds))
    if STEP_RATIOS[0] < length * each < STEP_RATIOS[1]:
        return ""
    pace = "slow" if length * each > STEP_RATIOS[0] else "fast"
    return (
        f"it is too {pace} for a person, {length:.2f} m a step every {each:.2f} s: was it recorded at another rate? "
        "Set source_rate_hz (--source-rate)"
    )
