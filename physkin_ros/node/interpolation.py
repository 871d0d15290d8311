"""Poses between joint states, for clouds at a rate of their own.

Clouds lag by the time between the last two joint states, so that there is always one on either side: nothing is ever
extrapolated. When joint states stop, so do the clouds, at the last of them. Dimensions: `d` degrees of freedom, `g`
garments.
"""

from __future__ import annotations

import numpy as np

__all__ = ["PoseInterpolator"]

LONGEST_GAP = 500_000_000  # [ns] joint states farther apart are not joined: the next one starts anew


class PoseInterpolator:
    """Straight lines between the last two poses; gravity is turned along, with its twist and load, how large it is."""

    def __init__(self, joint_count: int, garment_count: int = 1) -> None:
        self._pose = np.zeros((2, joint_count), dtype=np.float32)
        self._gravity = np.zeros((2, garment_count, 4), dtype=np.float32)
        self._load = np.zeros((2, garment_count, 1), dtype=np.float32)
        self._arrived = [0, 0]
        self._stamp = [0, 0]
        self._count = 0
        self._shown = True

    def push(self, pose: np.ndarray, gravity: np.ndarray, load: np.ndarray, stamp_ns: int, now_ns: int) -> None:
        """A joint state's pose (d,) [rad], unit gravity and twist (g, 4) and load (g, 1) with its stamp, and when it
        came [ns]."""
        for kept, new in ((self._pose, pose), (self._gravity, gravity), (self._load, load)):
            kept[0] = kept[1]
            kept[1] = new
        self._arrived = [self._arrived[1], now_ns]
        self._stamp = [self._stamp[1], stamp_ns]
        self._count += 1
        if self._count == 1 or not 0 < self._arrived[1] - self._arrived[0] < LONGEST_GAP:
            self._count = 1
        self._shown = False

    def sample(self, now_ns: int, pose: np.ndarray, gravity: np.ndarray, load: np.ndarray) -> int | None:
        """Write the pose (d,), unit gravity and twist (g, 4) and load (g, 1) to show now; returns its stamp [ns], None
        when nothing is new."""
        if self._shown:
            return None
        share = 1.0
        if self._count > 1:
            share = (now_ns - self._arrived[1]) / (self._arrived[1] - self._arrived[0])
        if share >= 1.0:
            share, self._shown = 1.0, True
        share = max(share, 0.0)
        for kept, out in ((self._pose, pose), (self._gravity, gravity), (self._load, load)):
            np.subtract(kept[1], kept[0], out=out)
            out *= share - 1.0
            out += kept[1]
        length = np.linalg.norm(gravity[:, :3], axis=1)
        opposite = length < 1e-6  # directions, half way
        gravity[opposite], length[opposite] = self._gravity[1][opposite], 1.0
        gravity[:, :3] /= length[:, None]
        return self._stamp[1] - round((1.0 - share) * (self._stamp[1] - self._stamp[0]))
