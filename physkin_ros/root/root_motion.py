"""From where the root is in the world, message by message, to what its garments feel."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from physkin_core import Sway
from physkin_core.runtime.draper import in_units_of_gravity
from physkin_core.sway.moment import Moment
from physkin_ros.root.gravity import SAME_CLOCK, Felt, gravity_from_quaternion
from physkin_ros.root.quaternions import OrientationError, Quaternion, Vector, unit_quaternion

__all__ = ["RootMotion"]


class RootMotion:
    """sways: how much the cloth of each garment lags, swings and settles as the root moves, 0 to 1."""

    def __init__(self, sways: Sequence[float]) -> None:
        self._sway: Sway | None = Sway()
        self._sways = tuple(sways)
        self._last_ns = 0

    def set_sway(self, sways: Sequence[float]) -> None:
        """Others, from now on."""
        self._sways = tuple(sways)

    def still(self) -> None:
        """Let the motion count no more, only gravity's direction."""
        self._sway = None

    def follows(self, stamp_ns: int) -> bool:
        """Whether a message of this stamp comes after the last; a clock that begins anew, or no stamp, does, too."""
        return not stamp_ns or not 0 <= self._last_ns - stamp_ns <= SAME_CLOCK

    def move(self, stamp_ns: int, place: Vector, turn: Quaternion) -> tuple[np.ndarray, Felt | None]:
        """The root is at `place` [m] in an upright frame, turned by a quaternion (x, y, z, w), root to that frame.

        Returns the direction of gravity (3,) in the root frame, and what each garment feels, None where nothing sways,
        or there is no stamp to know it by.
        Raises OrientationError for what is not finite or no rotation, and for a stamp before the last; ValueError for a
        place too far from the origin. The last good state then stays.
        """
        turn = unit_quaternion(turn)
        if not all(map(math.isfinite, place)):
            raise OrientationError(f"the root's position is {list(place)}; it must be finite [m]")
        if stamp_ns != self._last_ns and not self.follows(stamp_ns):
            raise OrientationError(f"the root's pose is stamped {1e-9 * (self._last_ns - stamp_ns):.3f} s back")
        self._last_ns = stamp_ns
        down, felt = gravity_from_quaternion(turn), None
        if self._sway is not None and any(self._sways) and stamp_ns:
            rows = self._rows(self._sway, 1e-9 * stamp_ns, (*place, *turn))
            known, velocity, turning = self._sway.motion()
            felt = Felt(rows, Moment(moves=float(known), velocity=velocity, turning=turning).after(down))
        return down, felt

    def _rows(self, sway: Sway, time: float, root: tuple[float, ...]) -> np.ndarray:
        of_amount = {}
        for amount in dict.fromkeys(self._sways):  # the root moves once: asked again, only the amount differs
            sway.amount = amount
            of_amount[amount] = (*in_units_of_gravity(sway.felt(time, root)), sway.twist)
        return np.array([of_amount[amount] for amount in self._sways], dtype=np.float32)
