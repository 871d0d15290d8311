"""Where down is, in the body's root frame: from an orientation, an IMU or two joints; and what accelerated roots feel.

Quaternions are x, y, z, w and turn the root frame into an upright one (Z up), as ROS gives orientations.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physkin_ros.messages.conversions import gravity_direction
from physkin_ros.root.quaternions import OrientationError, quaternion_of, unit_quaternion, vector_of

__all__ = [
    "FRESH",
    "SAME_CLOCK",
    "EffectiveGravity",
    "Felt",
    "GravityByStamp",
    "gravity_from_imu",
    "gravity_from_quaternion",
    "gravity_from_tilt",
    "unit_direction",
]

MOST_DIRECTIONS = 256
"""Directions of gravity that are kept: a quarter of a second of a fast IMU."""
FRESH = 500_000_000
"""[ns] Effective gravity counts for so long after it came."""
SAME_CLOCK = 1_000_000_000
"""[ns] Stamps farther apart than this, the wrong way round, are of different clocks."""


def unit_direction(down: Sequence[float]) -> np.ndarray:
    """Unit direction of gravity (3,) float32 from one of any length but zero."""
    down = np.array(down, dtype=np.float64)
    return (down / np.linalg.norm(down)).astype(np.float32)


def gravity_from_quaternion(quaternion: Sequence[float]) -> np.ndarray:
    """Unit direction of gravity (3,) in a frame of this orientation. Raises OrientationError for no rotation."""
    x, y, z, w = unit_quaternion(quaternion)
    return np.array([2 * (w * y - x * z), -2 * (y * z + w * x), 2 * (x * x + y * y) - 1])


def gravity_from_imu(message) -> np.ndarray:
    """Unit direction of gravity (3,) from a `sensor_msgs/Imu`: its orientation, or the acceleration it feels if it has
    none (the body is then taken to be at rest). Raises OrientationError.
    """
    if message.orientation_covariance[0] != -1.0:
        return gravity_from_quaternion(quaternion_of(message.orientation))
    felt = vector_of(message.linear_acceleration)
    try:
        down = gravity_direction([-number for number in felt])
    except ValueError:
        raise OrientationError(
            f"the IMU gives no orientation (covariance -1) and feels {list(felt)} m/s2; one is needed"
        ) from None
    return down / np.linalg.norm(down)


def gravity_from_tilt(roll: float, pitch: float) -> np.ndarray:
    """Unit direction of gravity (3,) in a root turned about its X by `roll`, then about the upright Y by `pitch` [rad].

    Raises OrientationError for angles that are not finite.
    """
    if not (math.isfinite(roll) and math.isfinite(pitch)):
        raise OrientationError(f"roll is {roll} and pitch {pitch}; they must be finite [rad]")
    across = math.cos(pitch)
    return np.array([math.sin(pitch), -across * math.sin(roll), -across * math.cos(roll)])


class GravityByStamp:
    """Pairs directions of gravity with joint states by their stamps [ns].

    A joint state goes with the latest direction stamped no later than itself; where all that are kept are later, with
    the earliest of them. It never waits. The direction that arrived last counts where the joint state has no stamp
    (zero), the direction has none, or all directions are more than a second later, so that the clocks do not agree.
    A direction without stamp, or one stamped more than a second before the latest, ends those before it.

    down: direction (3,), or what is felt, which is paired so, too, until there is another.
    """

    def __init__(self, down: np.ndarray) -> None:
        self._last = down
        self._stamps: list[int] = []
        self._directions: list[np.ndarray] = []

    def add(self, down: np.ndarray, stamp_ns: int) -> None:
        """Take a direction that has arrived."""
        stamps, directions = self._stamps, self._directions
        self._last = down
        if not stamp_ns or (stamps and stamp_ns < stamps[-1] - SAME_CLOCK):
            stamps.clear()
            directions.clear()
        if stamp_ns:
            at = bisect_right(stamps, stamp_ns)
            stamps.insert(at, stamp_ns)
            directions.insert(at, down)
            del stamps[:-MOST_DIRECTIONS], directions[:-MOST_DIRECTIONS]

    def at(self, stamp_ns: int) -> np.ndarray:
        """The direction that goes with a joint state."""
        stamps = self._stamps
        if not stamps or not stamp_ns:
            return self._last
        later = bisect_right(stamps, stamp_ns)
        if later:
            return self._directions[later - 1]
        return self._directions[0] if stamps[0] - stamp_ns <= SAME_CLOCK else self._last


@dataclass(frozen=True)
class Felt:
    """What garments feel while their root is accelerated.

    rows: (4,) of all or (garments, 4) float32, effective gravity in units of gravity, and the twist [rad]. root: where
    the root's pose tells how it moves, (14,) float32 gravity's direction and the root's rates behind it, as of
    `physkin_core.sway.moment`, by which sway networks move cloth; None where effective gravity alone is known.
    """

    rows: np.ndarray
    root: np.ndarray | None = None


class EffectiveGravity:
    """What is felt, paired with joint states as directions are, while it is fresh: when none has come for `FRESH`,
    there is none. Times of coming [ns] are monotonic."""

    def __init__(self) -> None:
        self._by_stamp: GravityByStamp | None = None
        self._came = 0

    def add(self, felt: Felt, stamp_ns: int, now_ns: int) -> None:
        """Take what has come now."""
        if self._by_stamp is None or now_ns - self._came > FRESH:
            self._by_stamp = GravityByStamp(felt)
        self._by_stamp.add(felt, stamp_ns)
        self._came = now_ns

    def at(self, stamp_ns: int, now_ns: int) -> Felt | None:
        """What goes with a joint state that has come now, None when nothing is fresh. stamp_ns 0: the latest."""
        if self._by_stamp is None or now_ns - self._came > FRESH:
            return None
        return self._by_stamp.at(stamp_ns)
