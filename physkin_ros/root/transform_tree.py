"""Where TF says a frame is, without tf2: each frame's place in its parent, over the last messages about it."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field

from physkin_ros.root.gravity import SAME_CLOCK
from physkin_ros.root.quaternions import (
    OrientationError,
    Quaternion,
    Vector,
    between,
    product,
    quaternion_of,
    rotated,
    unit_quaternion,
    vector_of,
)

__all__ = ["TransformTree"]

DEEPEST_CHAIN = 64
KEPT = 64
"""Places of a frame that are kept."""
MOST_FRAMES = 10_000
"""Frames beyond these are not taken: who invents names must not fill the memory."""
STILL = 100_000_000
"""[ns] A frame that nobody has moved for so long, while others moved, stands still and is not waited for: slower ones
are corrections mostly, which must not hold up the rest."""


@dataclass
class _Frame:
    """Where a frame is in its parent: stamps [ns] in order, places [m] and turns at them. static: at any time."""

    parent: str
    static: bool
    stamps: list[int] = field(default_factory=list)
    places: list[tuple[Vector, Quaternion]] = field(default_factory=list)

    def put(self, stamp_ns: int, place: tuple[Vector, Quaternion]) -> None:
        stamps = self.stamps
        if self.static or (stamps and stamp_ns < stamps[-1] - SAME_CLOCK):
            stamps.clear()
            self.places.clear()
        if stamps and stamp_ns < stamps[-1]:
            return  # late
        if stamps and stamp_ns == stamps[-1]:
            self.places[-1] = place
            return
        stamps.append(stamp_ns)
        self.places.append(place)
        del stamps[:-KEPT], self.places[:-KEPT]

    def at(self, stamp_ns: int) -> tuple[Vector, Quaternion]:
        """Between two messages on the way, before the first and after the last as there."""
        after = bisect_right(self.stamps, stamp_ns)
        if self.static or after == len(self.stamps):
            return self.places[-1]
        if after == 0:
            return self.places[0]
        share = (stamp_ns - self.stamps[after - 1]) / (self.stamps[after] - self.stamps[after - 1])
        (from_place, from_turn), (to_place, to_turn) = self.places[after - 1 : after + 1]
        place = tuple(a + share * (b - a) for a, b in zip(from_place, to_place))
        return place, between(from_turn, to_turn, share)


class TransformTree:
    """The frames of TF."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}

    def update(self, transforms: Iterable, *, static: bool = False) -> dict[str, str]:
        """Take over `geometry_msgs/TransformStamped`s. static: those of /tf_static.

        Returns what is wrong with those that are not taken, by frame; their last good place stays.
        """
        wrong = {}
        for transform in transforms:
            parent, child = transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")
            shift, stamp = vector_of(transform.transform.translation), transform.header.stamp
            try:
                turn = unit_quaternion(quaternion_of(transform.transform.rotation))
                if not all(map(math.isfinite, shift)):
                    raise OrientationError(f"translation is {list(shift)}; it must be finite [m]")
            except OrientationError as error:
                wrong[child] = f"transform from {parent!r} to {child!r}: {error}"
                continue
            known = self._frames.get(child)
            if known is None or known.parent != parent or known.static != static:
                if known is None and len(self._frames) >= MOST_FRAMES:
                    continue
                known = self._frames[child] = _Frame(parent, static)
            known.put(stamp.sec * 1_000_000_000 + stamp.nanosec, (shift, turn))
        return wrong

    def top(self, frame: str) -> str:
        """The frame above all that `frame` is in, itself where there is none. Raises OrientationError for a circle."""
        return self._above(frame, None)[1]

    def chain(self, frame: str, world: str) -> list[str]:
        """Frames from `frame` up to the one below `world`. Raises OrientationError when they do not lead there."""
        chain, end = self._above(frame, world)
        if end != world:
            raise OrientationError(f"no transform from {world!r} to {frame!r}: nothing is known above {end!r}")
        return chain

    def pose(self, frame: str, world: str) -> tuple[int, Vector, Quaternion]:
        """Where `frame` is in `world`: the stamp that this is of [ns], 0 for any, its place [m] and turn.

        The time is the latest that all frames between them are known at, but for those that stand still.
        Raises OrientationError as `chain` does.
        """
        chain = [self._frames[name] for name in self.chain(frame, world)]
        latest = [each.stamps[-1] for each in chain if not each.static and each.stamps[-1]]
        newest = max(latest, default=0)
        stamp = min((each for each in latest if newest - each <= STILL), default=0)
        place, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
        for each in chain:
            shift, outer = each.at(stamp or newest)
            place = tuple(a + b for a, b in zip(shift, rotated(outer, place)))
            turn = product(outer, turn)
        return stamp, place, turn

    def _above(self, frame: str, world: str | None) -> tuple[list[str], str]:
        chain = []
        while frame != world and frame in self._frames:
            if len(chain) == DEEPEST_CHAIN or frame in chain:
                raise OrientationError(f"the transforms above {chain[0]!r} go round in a circle")
            chain.append(frame)
            frame = self._frames[frame].parent
        return chain, frame
