"""Where TF says a frame is, without tf2: each frame's place in its parent, over the last messages about it."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from physkin_core.file_reading import shown
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

__all__ = ["LONGEST_NAME", "TransformTree"]

DEEPEST_CHAIN = 64
KEPT = 32
"""Places of a frame that are kept: corrections are stamped a second ahead, at up to some 30 Hz."""
MOST_FRAMES, LONGEST_NAME = 1000, 256
"""Frames beyond these, or with longer names, are not taken, some 14 MB: who invents names must not fill the memory."""
PACE = 4
"""The messages by which frames are compared: the faster one's so many-th last came later."""
LATEST = 100_000_000
"""[ns] How long a frame that comes often, too, is waited for: gravity is not older than that for it."""


@dataclass
class _Frame:
    """Where a frame is in its parent: stamps [ns] in order, places [m] and turns at them. static: at any time.

    arrivals: of its last messages, which ones they were among all of the tree's.
    """

    parent: str
    static: bool
    stamps: list[int] = field(default_factory=list)
    places: list[tuple[Vector, Quaternion]] = field(default_factory=list)
    arrivals: deque[int] = field(default_factory=lambda: deque(maxlen=PACE))

    def put(self, stamp_ns: int, place: tuple[Vector, Quaternion], arrival: int) -> None:
        stamps = self.stamps
        if self.static or (stamps and stamp_ns < stamps[-1] - SAME_CLOCK):
            stamps.clear()
            self.places.clear()
        if stamps and stamp_ns < stamps[-1]:
            return  # late
        if stamps and stamp_ns == stamps[-1]:
            self.places[-1] = place
            return
        self.arrivals.append(arrival)
        stamps.append(stamp_ns)
        self.places.append(place)
        del stamps[:-KEPT], self.places[:-KEPT]

    def at(self, stamp_ns: int) -> tuple[Vector, Quaternion]:
        """Between two messages on the way, before the first and after the last as there; the last of another clock."""
        after = bisect_right(self.stamps, stamp_ns)
        if self.static or after == len(self.stamps) or self.stamps[0] - stamp_ns > SAME_CLOCK:
            return self.places[-1]
        if after == 0:
            return self.places[0]
        share = (stamp_ns - self.stamps[after - 1]) / (self.stamps[after] - self.stamps[after - 1])
        (from_place, from_turn), (to_place, to_turn) = self.places[after - 1 : after + 1]
        place = tuple(a + share * (b - a) for a, b in zip(from_place, to_place))
        return place, between(from_turn, to_turn, share)


class TransformTree:
    """The frames of TF. left_out: which frame was the first that was not taken, and why; or ""."""

    def __init__(self) -> None:
        self.left_out = ""
        self._frames: dict[str, _Frame] = {}
        self._arrived = 0

    def update(self, transforms: Iterable, *, static: bool = False) -> dict[str, str]:
        """Take over `geometry_msgs/TransformStamped`s. static: those of /tf_static.

        Returns what is wrong with those that are not taken, by frame; their last good place stays.
        """
        wrong = {}
        for transform in transforms:
            parent, child = transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")
            if max(len(parent), len(child)) > LONGEST_NAME:
                why = f"names of frames have up to {LONGEST_NAME} characters"
                self.left_out = self.left_out or f"{shown(max(parent, child, key=len))}: {why}"
                continue
            shift, stamp = vector_of(transform.transform.translation), transform.header.stamp
            try:
                turn = unit_quaternion(quaternion_of(transform.transform.rotation))
                if not all(map(math.isfinite, shift)):
                    raise OrientationError(f"translation is {list(shift)}; it must be finite [m]")
            except OrientationError as error:
                wrong[child] = f"transform from {shown(parent)} to {shown(child)}: {error}"
                continue
            known = self._frames.get(child)
            if known is None or known.parent != parent or known.static != static:
                if known is None and len(self._frames) >= MOST_FRAMES:
                    self.left_out = self.left_out or f"{shown(child)} and further ones: {MOST_FRAMES} are known"
                    continue
                known = self._frames[child] = _Frame(parent, static)
            self._arrived += 1
            known.put(stamp.sec * 1_000_000_000 + stamp.nanosec, (shift, turn), self._arrived)
        return wrong

    def top(self, frame: str) -> str:
        """The frame above all that `frame` is in, itself where there is none. Raises OrientationError for a circle."""
        return self._above(frame, None)[1]

    def chain(self, frame: str, world: str) -> list[str]:
        """Frames from `frame` up to the one below `world`. Raises OrientationError when they do not lead there."""
        chain, end = self._above(frame, world)
        if end != world:
            raise OrientationError(
                f"no transform from {shown(world)} to {shown(frame)}: nothing is known above {shown(end)}"
            )
        return chain

    def pose(self, frame: str, world: str) -> tuple[int, Vector, Quaternion]:
        """Where `frame` is in `world`: the stamp that this is of [ns], 0 for any, its place [m] and turn.

        The time is the last of the frame nearest `frame` that comes often, or as much before as another such frame is
        late, `LATEST` at most. All others, late or stamped ahead, are taken at what is known of them nearest that time.
        Raises OrientationError as `chain` does.
        """
        chain = [self._frames[name] for name in self.chain(frame, world)]
        moving = [each for each in chain if not each.static and each.stamps[-1]]
        last = [each.stamps[-1] for each in self._often(moving)]
        stamp = min((each for each in last if 0 <= last[0] - each <= LATEST), default=0)
        place, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
        for each in chain:
            shift, outer = each.at(stamp)
            place = tuple(a + b for a, b in zip(shift, rotated(outer, place)))
            turn = product(outer, turn)
        return stamp, place, turn

    def _often(self, frames: list[_Frame]) -> list[_Frame]:
        """Those that come at least a third as often as the fastest; all, while none has come `PACE` times. Counted in
        messages, not by stamps: what is stamped ahead, or by an old clock, is no faster for it."""
        spans = [self._arrived + 1 - each.arrivals[0] if len(each.arrivals) == PACE else math.inf for each in frames]
        return [each for each, span in zip(frames, spans) if span <= 3 * min(spans)]

    def _above(self, frame: str, world: str | None) -> tuple[list[str], str]:
        chain = []
        while frame != world and frame in self._frames:
            if len(chain) == DEEPEST_CHAIN or frame in chain:
                raise OrientationError(f"the transforms above {shown(chain[0])} form a loop")
            chain.append(frame)
            frame = self._frames[frame].parent
        return chain, frame
