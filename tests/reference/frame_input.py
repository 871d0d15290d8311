"""What a garment is told of a frame besides joint positions: gravity, wind and how the root moves, 13 numbers each."""

from typing import NamedTuple

import numpy as np

from reference.root_tracker import LARGEST_GAP, RootTracker

GRAVITY, AIR_DRAG = 9.81, 2.0
"""[m/s2], and [1/s]: of cloth by the air that passes it."""
FASTEST_GUST = 30.0
"""[m/s2] Wind changes no faster."""
LARGEST_FELT = 2.999
"""In units of gravity: where wind is added, training knows no more."""
FASTEST = 1e6
"""[m/s, rad/s] A root is told to be no faster."""


class FrameInput(NamedTuple):
    """The numbers of a row, in their order; by default those of a drape by itself.

    gravity: (3,) effective gravity in units of gravity. passed: time [s] since the last frame, by which
    cloth keeps its pace; negative where that frame does not count. sway: how much of a sway
    network's offsets counts; at 0 it forgets what was before. elapsed: time [s] for the sway network, 0 where a stamp
    comes again, negative for a first frame. moves: whether rates of joints and root count. velocity [m/s] and turning
    [rad/s]: of the root since the last frame, in its frame of now, (3,) each.
    """

    gravity: np.ndarray = np.array([0.0, 0.0, -1.0])
    passed: float = -1.0
    sway: float = 0.0
    elapsed: float = -1.0
    moves: float = 0.0
    velocity: np.ndarray = np.zeros(3)
    turning: np.ndarray = np.zeros(3)

    @classmethod
    def of(cls, row):
        """Of a row (13,)."""
        row = np.asarray(row, dtype=np.float64)
        return cls(row[:3], *row[3:7].tolist(), row[7:10], row[10:])

    def row(self):
        """(13,) float32."""
        return np.concatenate([np.atleast_1d(each) for each in self]).astype(np.float32)


class ReferenceFrameInput:
    """From time, root and wind to the rows of garments that are worn together."""

    def __init__(self):
        self._root, self._last, self._passed, self._wind = RootTracker(), None, -1.0, None

    def rows(self, time, root, amounts, wind=(0.0, 0.0, 0.0)):
        """(g, 13) float32. time: [s]; root: (7,) position and quaternion x, y, z, w; amounts: how much each garment
        sways, 0 to 1; wind: (3,) [m/s] in the world."""
        elapsed = -1.0 if self._last is None else max(time - self._last, 0.0)
        if self._last is None or time != self._last:
            counts = self._last is not None and 0 < time - self._last <= LARGEST_GAP
            self._passed = time - self._last if counts else -1.0
            self._last = time
        self._root.move(time, root)
        self._blow(np.asarray(wind, dtype=np.float64), elapsed)
        return np.stack([self._row(amount, elapsed) for amount in amounts])

    def _blow(self, wind, elapsed):
        change = wind if self._wind is None else wind - self._wind
        if self._wind is None or np.linalg.norm(change) <= FASTEST_GUST * elapsed:
            self._wind = wind
        else:
            self._wind = self._wind + FASTEST_GUST * elapsed * change / np.linalg.norm(change)

    def _row(self, amount, elapsed):
        felt = self._root.turn.inv().apply([0, 0, -1] + AIR_DRAG * self._wind / GRAVITY)
        felt *= min(1.0, LARGEST_FELT / np.linalg.norm(felt)) if self._wind.any() else 1.0
        motion = self._root.motion()
        velocity, turning = np.zeros((2, 3)) if motion is None else np.clip(motion, -FASTEST, FASTEST)
        alone = FrameInput(felt, velocity=velocity, turning=turning)
        if amount == 0:
            return alone.row()
        moves = float(motion is not None and self._passed >= 0)
        return alone._replace(passed=self._passed, sway=amount, elapsed=elapsed, moves=moves).row()
