"""What messages have said of an avatar's root, and which of it goes with a joint state."""

from __future__ import annotations

import numpy as np

from physkin_core import FrameInput
from physkin_core.sway.frame_input import RootSample, unit_direction
from physkin_ros.root.gravity import EffectiveGravity, FreshByStamp, LatestByStamp

__all__ = ["RootState"]


class RootState:
    """Of one avatar. Stamps and times of coming are in ns, these monotonic.

    down: direction of gravity (3,), of any length but zero, in the root frame until another one comes. frame_input: of
    its garments. Nobody else writes its rows: `take` and `begin_frame` do, by how the root moves as far as that is
    known and fresh, or else by where down is.
    """

    def __init__(self, down: np.ndarray, frame_input: FrameInput) -> None:
        self.frame_input = frame_input
        self._directions = LatestByStamp(_as_networks_know(down))
        self._motions: FreshByStamp[RootSample | EffectiveGravity] = FreshByStamp()
        self._taken: RootSample | EffectiveGravity | np.ndarray = self.direction(0)

    def set_direction(self, down: np.ndarray) -> None:
        """Another direction of gravity (3,), of any length but zero, as of now."""
        self._directions.add(_as_networks_know(down), 0)

    def add_direction(self, down: np.ndarray, stamp_ns: int) -> None:
        """Take a unit direction (3,) that has come."""
        self._directions.add(down, stamp_ns)

    def add_motion(self, motion: RootSample | EffectiveGravity, stamp_ns: int, now_ns: int) -> None:
        """Take how the root moves, that has come."""
        self._motions.add(motion, stamp_ns, now_ns)

    def direction(self, stamp_ns: int) -> np.ndarray:
        """Gravity's unit direction (3,) that goes with a joint state, however the root is accelerated."""
        return self._directions.at(stamp_ns)

    def motion(self, now_ns: int) -> RootSample | EffectiveGravity | None:
        """How the root moves by the latest message; None where nothing is fresh."""
        return self._motions.at(0, now_ns)

    def take(self, stamp_ns: int, now_ns: int) -> np.ndarray:
        """Find what goes with a joint state. Returns the gravity (g, 3) that it gives the garments, wind apart."""
        known = self._motions.at(stamp_ns, now_ns)
        self._taken = self.direction(stamp_ns) if known is None else known
        self._fill()
        return self.frame_input.rows[:, :3]

    def begin_frame(self, sec: int, nanosec: int, gravity: np.ndarray | None = None) -> None:
        """Begin the frame of a joint state with this stamp; 0 for none: it then stands by itself.

        gravity: (g, 3) in place of what `take` has found.
        """
        if gravity is not None:
            self._fill()
            self.frame_input.rows[:, :3] = gravity
        self.frame_input.begin_frame(sec + 1e-9 * nanosec if sec or nanosec else None)

    def _fill(self) -> None:
        if isinstance(self._taken, EffectiveGravity):
            self.frame_input.set_effective_gravity(self._taken.vector, self._taken.at_rest)
        elif isinstance(self._taken, np.ndarray):
            self.frame_input.set_gravity(self._taken)
        else:
            self.frame_input.set_root_sample(self._taken)


def _as_networks_know(down: np.ndarray) -> np.ndarray:
    return unit_direction(down).astype(np.float32)
