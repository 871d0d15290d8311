"""Where the root is in the world, message by message, and how it moves by that."""

from __future__ import annotations

import math

import numpy as np

from physkin_core.sway.frame_input import RootSample, RootTracker
from physkin_ros.root.gravity import SAME_CLOCK, gravity_from_quaternion
from physkin_ros.root.quaternions import OrientationError, Quaternion, Vector, unit_quaternion

__all__ = ["RootMotion"]


class RootMotion:
    """Of one avatar."""

    def __init__(self) -> None:
        self._tracker: RootTracker | None = RootTracker()
        self._last_ns = 0

    def still(self) -> None:
        """Let the motion count no more, only gravity's direction."""
        self._tracker = None

    def follows(self, stamp_ns: int) -> bool:
        """Whether a message of this stamp comes after the last; a clock that begins anew, or no stamp, does, too."""
        return not stamp_ns or not 0 <= self._last_ns - stamp_ns <= SAME_CLOCK

    def move(self, stamp_ns: int, place: Vector, turn: Quaternion) -> tuple[np.ndarray, RootSample | None]:
        """The root is at `place` [m] in an upright frame, turned by a quaternion (x, y, z, w), root to that frame.

        Returns the direction of gravity (3,) in the root frame, and how the root moves, None without a stamp to know it
        by.
        Raises OrientationError for what is not finite or no rotation, and for a stamp before the last; ValueError for a
        place too far from the origin. The last good state then stays.
        """
        turn = unit_quaternion(turn)
        if not all(map(math.isfinite, place)):
            raise OrientationError(f"the root's position is {list(place)}; it must be finite [m]")
        if stamp_ns != self._last_ns and not self.follows(stamp_ns):
            raise OrientationError(f"the root's pose is stamped {1e-9 * (self._last_ns - stamp_ns):.3f} s back")
        self._last_ns = stamp_ns
        sample = None
        if self._tracker is not None and stamp_ns:
            sample = self._tracker.move(1e-9 * stamp_ns, np.array((*place, *turn), dtype=np.float64))
        return gravity_from_quaternion(turn), sample
