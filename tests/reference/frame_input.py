"""What a garment is told of a frame besides joint positions: gravity and how the root moves, 14 numbers a garment."""

from typing import NamedTuple

import numpy as np

from reference.pendulum import GRAVITY, LARGEST_GAP, Pendulum

FASTEST = 1e6
"""[m/s, rad/s] A root is told to be no faster."""


class FrameInput(NamedTuple):
    """The numbers of a row, in their order; by default those of a drape by itself.

    gravity: (3,) effective gravity in units of gravity. twist: [rad] of cloth round both legs. passed: time [s] since
    the last frame, by which cloth keeps its pace; negative where that frame does not count. sway: how much of a sway
    network's offsets counts; at 0 it forgets what was before. elapsed: time [s] for the sway network, 0 where a stamp
    comes again, negative for a first frame. moves: whether rates of joints and root count. velocity [m/s] and turning
    [rad/s]: of the root since the last frame, in its frame of now, (3,) each.
    """

    gravity: np.ndarray = np.array([0.0, 0.0, -1.0])
    twist: float = 0.0
    passed: float = -1.0
    sway: float = 0.0
    elapsed: float = -1.0
    moves: float = 0.0
    velocity: np.ndarray = np.zeros(3)
    turning: np.ndarray = np.zeros(3)

    @classmethod
    def of(cls, row):
        """Of a row (14,)."""
        row = np.asarray(row, dtype=np.float64)
        return cls(row[:3], *row[3:8].tolist(), row[8:11], row[11:])

    def row(self):
        """(14,) float32."""
        return np.concatenate([np.atleast_1d(each) for each in self]).astype(np.float32)


class ReferenceFrameInput:
    """From time and root to the rows of garments that are worn together.

    learnt: whether each garment has a sway network; others are moved by the pendulum.
    """

    def __init__(self, learnt):
        self._pendulum, self._learnt, self._last = Pendulum(), learnt, None
        self._passed = -1.0

    def rows(self, time, root, amounts):
        """(g, 14) float32. time: [s]; root: (7,) position and quaternion x, y, z, w; amounts: how much each garment
        sways, 0 to 1."""
        elapsed = -1.0 if self._last is None else max(time - self._last, 0.0)
        if self._last is None or time != self._last:
            counts = self._last is not None and 0 < time - self._last <= LARGEST_GAP
            self._passed = time - self._last if counts else -1.0
            self._last = time
        return np.stack([self._row(time, root, *each, elapsed) for each in zip(amounts, self._learnt)])

    def _row(self, time, root, amount, learnt, elapsed):
        felt, twist = self._pendulum.felt(time, root, 0.0 if learnt else amount)
        motion = self._pendulum.motion()
        velocity, turning = np.zeros((2, 3)) if motion is None else np.clip(motion, -FASTEST, FASTEST)
        alone = FrameInput(felt / GRAVITY, velocity=velocity, turning=turning)
        if amount == 0:
            return alone.row()
        moves, sway = float(motion is not None and self._passed >= 0), amount if learnt else 0.0
        told = {"twist": twist, "passed": self._passed, "sway": sway, "elapsed": elapsed, "moves": moves}
        return alone._replace(**told).row()
