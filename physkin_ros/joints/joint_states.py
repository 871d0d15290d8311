"""Joint states, whatever their naming, as the joint positions of a rig.

What a list of names means is worked out once (`JointNaming`) and kept: a message whose names came before costs a few
array operations and no work on strings. Dimensions: `d` degrees of freedom. Radians.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import physkin_core._native as _native

from physkin_core.file_reading import shown
from physkin_core.rig.ball_joints import BallJoint, BallJoints
from physkin_ros.joints.joint_map import MappedJoint

__all__ = [
    *("JointNaming", "JointStateError", "JointStateReader", "MappedNames", "NamedJoints", "NoPositionsError"),
    "Selection",
]

CACHED_NAMES = 1 << 15
"""Names, of all the lists that are kept; each takes some 200 bytes."""
CACHED_CHARACTERS = 1 << 20
LONGEST_PREFIX, MOST_PREFIXES = 60, 16
"""What is tried for a hint: strangers choose names."""
FARTHEST = 3 * np.pi
"""[rad] No joint turns one and a half times: a position beyond was probably meant in degrees."""


class JointStateError(ValueError):
    """A joint state cannot be used; the text says what is wrong with it."""


class NoPositionsError(JointStateError):
    """A joint state names joints but has no position, as those that carry velocities or efforts alone."""


@dataclass
class NamedJoints:
    """What a list of names means to a rig.

    scaled: (index of the name, rig joint, scale, offset): the joint's position is scale * value + offset.
    balls: ball joints, each with the indices of the names of its three angles, -1 for one that counts as zero.
    unknown: indices of the names that mean nothing.
    """

    scaled: list[tuple[int, str, float, float]] = field(default_factory=list)
    balls: list[tuple[BallJoint, tuple[int, int, int]]] = field(default_factory=list)
    unknown: list[int] = field(default_factory=list)


class JointNaming(Protocol):
    """How joints are named in the messages."""

    def look_up(self, names: Sequence[str]) -> NamedJoints:
        """What these names mean. Raises JointStateError when they contradict one another."""


class MappedNames:
    """The rig's own names, and those of a joint map."""

    def __init__(self, joint_names: Sequence[str], joint_map: Mapping[str, MappedJoint] | None = None) -> None:
        self._joints = frozenset(joint_names)
        self._map = dict(joint_map or {})

    def look_up(self, names: Sequence[str]) -> NamedJoints:
        """See `JointNaming`."""
        found = NamedJoints()
        for index, name in enumerate(names):
            entry = self._map.get(name) or MappedJoint(name)
            if entry.joint in self._joints:
                found.scaled.append((index, entry.joint, entry.scale, entry.offset))
            else:
                found.unknown.append(index)
        return found


@dataclass(frozen=True)
class Selection:
    """Which values of a message go where: positions[target] = scale * values[source] + offset, and ball joints.

    names: of the message.
    """

    names: tuple[str, ...]
    source: np.ndarray
    target: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    balls: BallJoints | None

    def apply(self, values: np.ndarray, positions: np.ndarray) -> tuple[int | None, list[int]]:
        """Write the joints that the message names into `positions` (d,) float32.

        values: float64, one a name. Returns the index of a value beyond `FARTHEST`, if there is one, and those of
        values that are not finite in single precision: what they drive stays as it was in `positions`. Raises
        JointStateError, `positions` unchanged, when none is finite.
        """
        taken = values[self.source]
        with np.errstate(over="ignore", invalid="ignore"):
            read = (self.scale * taken + self.offset).astype(np.float32)
            square = np.dot(read, read)
        far, lost = None, []
        if not square <= FARTHEST**2:  # or not finite: looked into only then
            far, lost = self._odd(read, self.source)
            read = np.where(np.isfinite(read), read, positions[self.target])
        if self.balls is not None:
            angles, kept = self.balls.gather(values), []
            with np.errstate(over="ignore", invalid="ignore"):
                square = np.dot(angles.ravel(), angles.ravel())
            if not square <= FARTHEST**2:
                with np.errstate(over="ignore"):
                    single = values.astype(np.float32)
                odd, lost_angles = self._odd(single[self.balls.sources], self.balls.sources)
                far = far if odd is None else odd
                kept, lost = self.balls.targets_without(angles.astype(np.float32)), lost + lost_angles
            before = positions[kept]
            with np.errstate(invalid="ignore"):
                self.balls.solve(angles, positions)
            positions[kept] = before
        if lost and len(lost) == len(self.source) + (0 if self.balls is None else len(self.balls.sources)):
            name, value = shown(self.names[lost[0]]), values[lost[0]]
            raise JointStateError(f"the position of joint {name} is {value}; it must be finite [rad]")
        positions[self.target] = read
        return far, lost

    def bind_reading(self, first: int, swapped: bool, start: np.ndarray, out: np.ndarray) -> _native.JointReading:
        """A native reader of ordinary messages of these names, ball joints apart, bound to its arrays once.

        Its `read(message)` does what `apply` does, over `start` (d,), into `out` (d,), both float32. It returns False
        and changes nothing when a value is not finite, beyond `FARTHEST` or cut off: then `apply` tells which.
        first: where the values begin in the bytes of a message. swapped: they are of the other byte order.
        """
        indices = self.source.tolist(), self.target.tolist()
        return _native.JointReading(
            *indices, self.scale.tolist(), self.offset.tolist(), first, swapped, FARTHEST, start, out
        )

    @staticmethod
    def _odd(read: np.ndarray, source: np.ndarray) -> tuple[int | None, list[int]]:
        """Index of the value that is farthest beyond `FARTHEST`, if there is one, and of those that are not finite.

        read: positions in single precision, of the values with the indices `source`.
        """
        finite = np.isfinite(read)
        sizes = np.where(finite, np.abs(read), 0.0)
        farthest = int(sizes.argmax())
        return int(source[farthest]) if sizes[farthest] > FARTHEST else None, source[~finite].tolist()


class JointStateReader:
    """Turns joint states into the joint positions of a rig, whatever the order and number of joints they name.

    Joints that a message does not name keep their last position.
    joint_names, rest: (d,) names and initial positions [rad]. naming: of the messages, default the rig's own names.
    prefix: what names begin with besides, such as `robot1_`; those without it are looked up, too.
    on_unknown: called with the names that mean nothing here, once for each new set of names.
    on_degrees: called with the name and value of a position beyond `FARTHEST`, which is taken as it is.
    on_not_finite: called with the names of joints that keep their position, as the message's is not finite.
    positions: (d,) float32 [rad], the last good state.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        rest: np.ndarray,
        *,
        naming: JointNaming | None = None,
        prefix: str = "",
        on_unknown: Callable[[list[str]], None] = lambda names: None,
        on_degrees: Callable[[str, float], None] = lambda name, value: None,
        on_not_finite: Callable[[list[str]], None] = lambda names: None,
    ) -> None:
        self.joint_names, self.prefix = tuple(joint_names), prefix
        self._positions = np.array(rest, dtype=np.float32)
        self._naming = MappedNames(joint_names) if naming is None else naming
        self._index = {name: index for index, name in enumerate(joint_names)}
        self._on_unknown, self._on_degrees, self._on_not_finite = on_unknown, on_degrees, on_not_finite
        self._selections: dict[tuple[str, ...], Selection] = {}
        self._cached = self._cached_characters = 0

    @property
    def positions(self) -> np.ndarray:
        """See the class: one array, changed in place."""
        return self._positions

    @positions.setter
    def positions(self, positions: np.ndarray) -> None:
        self._positions[:] = positions

    def read(self, names: Sequence[str], values: Sequence[float]) -> np.ndarray:
        """Joint positions (d,) float32 [rad] after a joint state; assign to `positions` to keep them.

        names, values: name and position [rad] of a `sensor_msgs/JointState`, of equal length.
        Raises JointStateError when it names no joint, none that is known or one twice, has another number of positions
        than names, or for known joints only positions that are not finite in single precision.
        """
        names = tuple(names)
        values = np.asarray(values, dtype=np.float64)
        self.check_count(names, len(values))
        positions = np.empty_like(self.positions)
        self.read_selected(self.select(names), values, positions)
        return positions

    @staticmethod
    def check_count(names: Sequence[str], count: int) -> None:
        """Raises JointStateError unless there are names, and as many positions."""
        if not names:
            raise JointStateError("the joint state names no joints")
        if count != len(names):
            kind = JointStateError if count else NoPositionsError
            raise kind(f"the joint state has {len(names)} names but {count} positions")

    def read_selected(self, selection: Selection, values: np.ndarray, out: np.ndarray) -> None:
        """Write the joint positions (d,) after a message of a selection's names into `out`. Raises as `read` does."""
        np.copyto(out, self.positions)
        far, lost = selection.apply(values, out)
        if far is not None:
            self._on_degrees(selection.names[far], float(values[far]))
        if lost:
            self._on_not_finite([selection.names[index] for index in lost])

    def select(self, names: tuple[str, ...]) -> Selection:
        """What these names select, looked up once for each set of names. Raises JointStateError."""
        return self._selections.get(names) or self._look_up(names)

    def _look_up(self, names: tuple[str, ...]) -> Selection:
        found = self._naming.look_up([name.removeprefix(self.prefix) for name in names])
        if not found.scaled and not found.balls:
            raise JointStateError(
                f"no joint is known among {_some(names)}; {self._prefix_hint(names)}the rig has "
                f"{_some(list(self._index))}; others need joint_map"
            )
        driven: dict[str, str] = {}
        drives = [(joint, index) for index, joint, _, _ in found.scaled]
        drives += [(joint, max(sources)) for ball, sources in found.balls for joint in ball.joints if joint]
        for joint, index in drives:
            if joint in driven:
                both = f"{shown(driven[joint])} and {shown(names[index])}"
                raise JointStateError(f"joints {both} are the same joint, {joint!r}")
            driven[joint] = names[index]
        if found.unknown:
            self._on_unknown([names[index] for index in found.unknown])
        selection = Selection(
            names=names,
            source=np.array([index for index, _, _, _ in found.scaled], dtype=np.intp),
            target=np.array([self._index[joint] for _, joint, _, _ in found.scaled], dtype=np.intp),
            scale=np.array([scale for _, _, scale, _ in found.scaled]),
            offset=np.array([offset for _, _, _, offset in found.scaled]),
            balls=BallJoints(found.balls, self._index) if found.balls else None,
        )
        self._keep(names, selection)
        return selection

    def _prefix_hint(self, names: tuple[str, ...]) -> str:
        """What names begin with, where they are known without it; empty where none is."""
        best, most = "", 0
        ends = [(name, end) for name in names[:4] for end in re.finditer("[^A-Za-z0-9]+", name[:LONGEST_PREFIX])]
        for prefix in dict.fromkeys(name[: end.end()] for name, end in ends[:MOST_PREFIXES]):
            stripped = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
            with suppress(JointStateError):
                if (known := len(stripped) - len(self._naming.look_up(stripped).unknown)) > most:
                    best, most = prefix, known
        return f"they match without {shown(best)}, which joint_prefix leaves out; " if best else ""

    def _keep(self, names: tuple[str, ...], selection: Selection) -> None:
        """Know the names again, and forget all others where these are too many: whoever invents names must not fill the
        memory."""
        characters = sum(map(len, names))
        self._cached += len(names)
        self._cached_characters += characters
        if self._cached > CACHED_NAMES or self._cached_characters > CACHED_CHARACTERS:
            self._selections.clear()
            self._cached, self._cached_characters = len(names), characters
        self._selections[names] = selection


def _some(names: Sequence[str], count: int = 4) -> str:
    more = f" and {len(names) - count} more" if len(names) > count else ""
    return ", ".join(map(shown, names[:count])) + more
