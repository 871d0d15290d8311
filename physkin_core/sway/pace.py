"""The pace of cloth: between two frames garment nodes go no farther than their bones carry them, and a little more.

Where cloth can lie in two places, networks switch from one to the other within a few degrees of a joint: cloth leaps by
a hand's breadth from one frame to the next. Told how much time has passed, it goes over in some frames instead.

Dimensions: `m` garment nodes. Metres, seconds, root frame.
"""

from __future__ import annotations

import math

import numpy as np

from physkin_core.sway.pendulum import LARGEST_GAP

__all__ = ["JUMP", "PACE", "REACH", "UNTOLD", "FrameClock", "Pace"]

PACE = 2.0
"""[m/s] by which a garment node, and cloth beside it, may be faster than its bone."""
REACH = 0.1
"""[m] How far beside a garment node cloth lies that it carries."""
JUMP = 0.5
"""[rad], and of gravity. Where a joint has moved farther since the last frame, nothing before it counts."""

UNTOLD = -1.0
"""In place of a time that has passed: what was before does not count."""


class FrameClock:
    """How much time passes between frames."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """The next frame is the first one."""
        self._time: float | None = None
        self._passed = self._elapsed = UNTOLD

    def passed(self, time: float) -> float:
        """Time [s] since the last frame, at `time` [s] of any clock; `UNTOLD` for the first one, after more than a
        quarter of a second, or where the clock goes back. Where it stands, what was said last is said again: a joint
        state may come in parts. Raises ValueError unless it is finite."""
        if not math.isfinite(time):
            raise ValueError(f"time must be finite, got {time}")
        passed = UNTOLD if self._time is None else time - self._time
        self._elapsed = UNTOLD if self._time is None else max(passed, 0.0)
        if passed != 0:
            self._time = float(time)
            self._passed = passed if 0 < passed <= LARGEST_GAP else UNTOLD
        return self._passed

    @property
    def elapsed(self) -> float:
        """Time [s] between the last two frames, however long; 0 where the clock stood or went back, `UNTOLD` for the
        first frame."""
        return self._elapsed


class Pace:
    """What is kept of the last frame, of one garment."""

    def __init__(self) -> None:
        self._last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def kept(self, posed: np.ndarray, nodes: np.ndarray, passed: float) -> np.ndarray:
        """Garment nodes (m, 3, 4), brought back on the way where they have leapt, or turned over in their bone.

        posed: (m, 3, 4) garment nodes as their bones alone put them. nodes: as draped. passed: since the last frame;
        negative where what was before does not count.
        """
        turn, carried = posed[:, :, :3], posed[:, :, 3]
        linear, position = turn.transpose(0, 2, 1) @ nodes[:, :, :3], nodes[:, :, 3]
        kept = nodes.copy()
        if self._last is not None and passed >= 0:
            last_linear, last_position, last_carried = self._last
            allowed = PACE * passed
            free = np.linalg.norm(carried - last_carried, axis=1) + allowed
            moves = _share(free, np.linalg.norm(position - last_position, axis=1))
            turns = _share(allowed, REACH * np.linalg.norm(linear - last_linear, axis=(1, 2)))
            position = np.where(
                moves[:, None] < 1, last_position + moves[:, None] * (position - last_position), position
            )
            share = turns[:, None, None]
            linear = np.where(share < 1, last_linear + share * (linear - last_linear), linear)
            kept[:, :, 3] = position
            kept[turns < 1, :, :3] = (turn @ linear)[turns < 1]
        self._last = linear, position, carried
        return kept


def _share(allowed: np.ndarray | float, wanted: np.ndarray) -> np.ndarray:
    return np.where(wanted > allowed, allowed / np.maximum(wanted, 1e-30), 1.0)
