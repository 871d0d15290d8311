"""Where down is, in the body's root frame: from an orientation or an IMU; and what accelerated roots feel.

Quaternions are x, y, z, w and turn the root frame into an upright one (Z up), as ROS gives orientations.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from physkin_ros.messages.conversions import gravity_direction
from physkin_ros.root.quaternions import OrientationError, quaternion_of, unit_quaternion, vector_of

__all__ = [
    "FRESH",
    "SAME_CLOCK",
    "EffectiveGravity",
    "FreshByStamp",
    "LatestByStamp",
    "gravity_from_imu",
    "gravity_from_quaternion",
]

MOST_KEPT = 256
"""Entries that are kept: a quarter of a second of a fast IMU."""
FRESH = 500_000_000
"""[ns] How the root moves counts for so long after it came."""
SAME_CLOCK = 1_000_000_000
"""[ns] Stamps farther apart than this, the wrong way round, are of different clocks."""


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
    acceleration = vector_of(message.linear_acceleration)
    try:
        down = gravity_direction([-number for number in acceleration])
    except ValueError:
        raise OrientationError(
            f"the IMU gives no orientation (covariance -1) and measures {list(acceleration)} m/s2; one is needed"
        ) from None
    return down / np.linalg.norm(down)


Kept = TypeVar("Kept")


class LatestByStamp(Generic[Kept]):
    """Pairs what is known of a root, such as directions of gravity, with joint states by their stamps [ns].

    A joint state goes with the latest entry stamped no later than itself; where all that are kept are later, with the
    earliest of them. It never waits. The entry that arrived last counts where the joint state has no stamp (zero), the
    entry has none, or all are more than a second later, so that the clocks do not agree. An entry without stamp, or one
    stamped more than a second before the latest, ends those before it.

    last: what counts until there is another.
    """

    def __init__(self, last: Kept) -> None:
        self._last = last
        self._stamps: list[int] = []
        self._entries: list[Kept] = []

    def add(self, entry: Kept, stamp_ns: int) -> None:
        """Take one that has arrived."""
        stamps, entries = self._stamps, self._entries
        self._last = entry
        if not stamp_ns or (stamps and stamp_ns < stamps[-1] - SAME_CLOCK):
            stamps.clear()
            entries.clear()
        if stamp_ns:
            at = bisect_right(stamps, stamp_ns)
            stamps.insert(at, stamp_ns)
            entries.insert(at, entry)
            del stamps[:-MOST_KEPT], entries[:-MOST_KEPT]

    def at(self, stamp_ns: int) -> Kept:
        """What goes with a joint state."""
        stamps = self._stamps
        if not stamps or not stamp_ns:
            return self._last
        later = bisect_right(stamps, stamp_ns)
        if later:
            return self._entries[later - 1]
        return self._entries[0] if stamps[0] - stamp_ns <= SAME_CLOCK else self._last


class FreshByStamp(Generic[Kept]):
    """The same of what counts only while it is fresh: when nothing has come for `FRESH`, there is none. Times of coming
    [ns] are monotonic."""

    def __init__(self) -> None:
        self._by_stamp: LatestByStamp[Kept] | None = None
        self._came = 0

    def add(self, entry: Kept, stamp_ns: int, now_ns: int) -> None:
        """Take what has come now."""
        if self._by_stamp is None or now_ns - self._came > FRESH:
            self._by_stamp = LatestByStamp(entry)
        self._by_stamp.add(entry, stamp_ns)
        self._came = now_ns

    def at(self, stamp_ns: int, now_ns: int) -> Kept | None:
        """What goes with a joint state that has come now, None when nothing is fresh. stamp_ns 0: the latest."""
        if self._by_stamp is None or now_ns - self._came > FRESH:
            return None
        return self._by_stamp.at(stamp_ns)


@dataclass(frozen=True)
class EffectiveGravity:
    """What an accelerated root feels, where no more is known of its motion.

    vector: (3,) [m/s2] in the root frame, at most three times gravity. at_rest: (3,) [m/s2] what it would be without
    acceleration; garments feel as much of the difference as they sway.
    """

    vector: np.ndarray
    at_rest: np.ndarray
