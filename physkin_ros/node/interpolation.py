"""Poses between joint states, for clouds at a rate of their own.

Clouds lag by the time between the last two joint states, so that there is always one on either side: nothing is ever
extrapolated. When joint states stop, so do the clouds, at the last of them. Dimensions: `d` degrees of freedom, `g`
garments.
"""

from __future__ import annotations

import numpy as np

__all__ = ["PoseInterpolator"]

WEIGHTLESS = 1e-3  # of gravity: effective gravity that is smaller has no direction
LONGEST_GAP = 500_000_000  # [ns] joint states farther apart are not joined: the next one starts anew


class PoseInterpolator:
    """Straight lines between the last two poses; gravity is turned along, its size goes straight."""

    def __init__(self, joint_count: int, garment_count: int = 1) -> None:
        self._pose = np.zeros((2, joint_count), dtype=np.float32)
        self._gravity = np.zeros((2, garment_count, 3), dtype=np.float32)  # unit direction
        self._size = np.ones((2, garment_count, 1), dtype=np.float32)
        self._arrived = [0, 0]
        self._stamp = [0, 0]
        self._count = 0
        self._shown = True

    def push(self, pose: np.ndarray, gravity: np.ndarray, stamp_ns: int, now_ns: int) -> None:
        """A joint state's pose (d,) [rad], effective gravity (g, 3), its stamp, and when it came [ns]."""
        for kept in (self._pose, self._gravity, self._size):
            kept[0] = kept[1]
        self._pose[1] = pose
        self._size[1] = size = np.linalg.norm(gravity, axis=1, keepdims=True)
        np.divide(gravity, size, out=self._gravity[1], where=size > WEIGHTLESS)  # else the last direction stays
        self._arrived = [self._arrived[1], now_ns]
        self._stamp = [self._stamp[1], stamp_ns]
        self._count += 1
        if self._count == 1 or not 0 < self._arrived[1] - self._arrived[0] < LONGEST_GAP:
            self._count = 1
        self._shown = False

    def sample(self, now_ns: int) -> tuple[int, np.ndarray, np.ndarray] | None:
        """Stamp [ns], pose (d,) and effective gravity (g, 3) to show now; None when nothing is new."""
        if self._shown:
            return None
        share = 1.0
        if self._count > 1:
            share = (now_ns - self._arrived[1]) / (self._arrived[1] - self._arrived[0])
        if share >= 1.0:
            share, self._shown = 1.0, True
        share = max(share, 0.0)

        def between(kept: np.ndarray) -> np.ndarray:
            return kept[1] + (kept[1] - kept[0]) * np.float32(share - 1.0)

        pose, gravity, size = map(between, (self._pose, self._gravity, self._size))
        length = np.linalg.norm(gravity, axis=1)
        opposite = length < 1e-6  # directions, half way
        gravity[opposite], length[opposite] = self._gravity[1][opposite], 1.0
        gravity *= size / length[:, None]
        return self._stamp[1] - round((1.0 - share) * (self._stamp[1] - self._stamp[0])), pose, gravity
