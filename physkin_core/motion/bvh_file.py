"""BVH files: a tree of joints, then a row of numbers for each frame. Whatever the keywords' case and the line breaks.

Dimensions: `T` frames. Lengths in the file's own unit, angles in degrees.
"""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from physkin_core.file_reading import ContentError, finite_numbers, read_text, shown, with_decimal_points
from physkin_core.motion.mocap_files import MOST_JOINTS, Joint, Skeleton

__all__ = ["read_bvh"]

log = logging.getLogger(__name__)

FRAME_TIMES = (1e-5, 10.0)  # [s]
COMMENT = re.compile(r"^\s*(#|//).*|\s(#|//)\s.*")
CHANNEL = re.compile(r"([XYZ])_?(ROT|POS|SCA)[A-Z]*", re.IGNORECASE)
HEADING = re.compile(r"(frames|frame[\s_]*time)\s*[:=]?\s*([^\s:=]+)", re.IGNORECASE)
KEYWORDS = "ROOT, JOINT, End Site, OFFSET, CHANNELS, {, } and MOTION"


@dataclass
class _Drawn:
    """A joint of the tree. channels: axis, an index into XYZ, and kind, ROT, POS or SCA, of each of its columns."""

    name: str
    parent: int
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    channels: list[tuple[int, str]] = field(default_factory=list)

    def columns(self, kind: str) -> list[int]:
        return [column for column, (_, its) in enumerate(self.channels) if its == kind]

    def axes(self, kind: str) -> list[int]:
        return [axis for axis, its in self.channels if its == kind]


def read_bvh(path: Path) -> Skeleton:
    """Read a file. Where its joints have positions of their own, the first frame's are the offsets at rest.

    Warns where it says another number of frames than it has. Raises OSError where it cannot be opened, and
    ContentError, with the line, for what is no BVH.
    """
    lines = enumerate(read_text(path).split("\n"), 1)
    tree = _tree(lines)
    width = sum(len(joint.channels) for joint in tree)
    said, step, frames = _frames(lines, width)
    if said != str(len(frames)):
        log.warning("%s: it says that it has %s frames; the %d that it has are taken", path, shown(said), len(frames))
    blocks = np.split(frames, np.cumsum([len(joint.channels) for joint in tree])[:-1], axis=1)
    added = _are_added(tree, blocks)
    found = []
    for joint, block in zip(tree, blocks):
        offset, places, moved = joint.offset, None, joint.axes("POS")
        if moved:
            places = np.tile(offset, (len(frames), 1))
            places[:, moved] = block[:, joint.columns("POS")] + (offset[moved] if added and joint.parent >= 0 else 0.0)
            offset = places[0] if joint.parent >= 0 else offset
        order = "".join("XYZ"[axis] for axis in joint.axes("ROT"))
        found.append(Joint(joint.name, joint.parent, offset, order, block[:, joint.columns("ROT")], places))
    return Skeleton(tuple(found), 1 / step)


def _tree(lines: Iterator[tuple[int, str]]) -> list[_Drawn]:
    """The joints, parents first; takes the lines up to MOTION."""
    tree: list[_Drawn] = []
    braces: list[int | None] = []  # joints, None for an End Site
    current: int | None = None
    for number, line in lines:
        words = deque(re.sub("([{}])", r" \1 ", with_decimal_points(COMMENT.sub("", line))).split())
        while words:
            word = words.popleft()
            keyword = word.upper()
            if keyword in ("ROOT", "JOINT") and None not in braces:
                current = len(tree)
                tree.append(_Drawn(_name(words), braces[-1] if braces else -1))
                if current == MOST_JOINTS:
                    raise ContentError(f"line {number}: it has over {MOST_JOINTS} joints, which is the most allowed")
            elif keyword in ("END", "ENDSITE"):
                _name(words)
                current = None
            elif keyword == "OFFSET":
                if len(offset := finite_numbers([words.popleft() for _ in range(min(3, len(words)))])) != 3:
                    raise ContentError(f"line {number}: OFFSET must have three finite numbers")
                if current is not None:
                    tree[current].offset = np.array(offset)
            elif keyword == "CHANNELS" and words and words[0].isdecimal():
                words.popleft()  # their names count
            elif tree and current is not None and (match := CHANNEL.fullmatch(word)):
                channel = "XYZ".index(match[1].upper()), match[2].upper()
                if channel in tree[current].channels:
                    raise ContentError(f"line {number}: joint {shown(tree[current].name)} has channel {word} twice")
                tree[current].channels.append(channel)
            elif keyword == "{":
                braces.append(current)
            elif keyword == "}" and braces:
                braces.pop()
                current = braces[-1] if braces else None
            elif keyword == "MOTION" and tree and not braces:
                return tree
            elif keyword != "HIERARCHY":
                within = f"within {len(braces)} open braces" if braces else "here"
                raise ContentError(f"line {number}: {shown(word)} cannot stand {within}; allowed are {KEYWORDS}")
    raise ContentError("it has no line MOTION after a tree of joints: it is cut off, or no BVH")


def _name(words: deque[str]) -> str:
    """Takes the words up to a brace."""
    name = []
    while words and words[0] != "{":
        name.append(words.popleft())
    return " ".join(name)


def _are_added(tree: list[_Drawn], blocks: list[np.ndarray]) -> bool:
    """Whether positions are added to the offsets. Those of most exporters replace them, so that both lie alike."""
    along = lengths = 0.0
    for joint, block in zip(tree, blocks):
        if joint.parent >= 0 and (moved := joint.axes("POS")):
            place, offset = np.median(block[:, joint.columns("POS")], axis=0), joint.offset[moved]
            along += place @ offset
            lengths += np.linalg.norm(place) * np.linalg.norm(offset)
    return along <= lengths / 2


def _frames(lines: Iterator[tuple[int, str]], width: int) -> tuple[str, float, np.ndarray]:
    """How many frames there are as it says, their time step [s] and values (T, width)."""
    said: dict[str, str] = {}
    rows: dict[int, str] = {}
    for number, line in lines:
        if not rows and (headings := HEADING.findall(line)):
            said |= {"time" if "time" in key.lower() else "frames": value for key, value in headings}
        elif line := COMMENT.sub("", line).strip():
            rows[number] = with_decimal_points(line)
    try:
        step = float(with_decimal_points(said["time"]))
    except (KeyError, ValueError):
        raise ContentError(f"'Frame Time: SECONDS' must follow MOTION, got {shown(said.get('time', 'none'))}") from None
    if not FRAME_TIMES[0] <= step <= FRAME_TIMES[1]:
        raise ContentError(f"its frame time is {step:g} s, allowed are {FRAME_TIMES[0]:g} to {FRAME_TIMES[1]:g} s")
    try:
        frames = np.loadtxt(list(rows.values()), ndmin=2) if rows else np.empty((0, 0))
    except ValueError:
        frames = np.empty((0, 0))
    if not rows or frames.shape != (len(rows), width) or not np.isfinite(frames).all():
        raise ContentError(_wrong_row(rows, width))
    return said.get("frames", "no"), step, frames


def _wrong_row(rows: dict[int, str], width: int) -> str:
    """What is wrong with the first that is not right. rows: by the number of their line."""
    for frame, (number, row) in enumerate(rows.items(), 1):
        words, row_is = row.split(), f"line {number}, frame {frame} of {len(rows)},"
        if wrong := [word for word in words if not finite_numbers([word])]:
            return f"{row_is} has {shown(wrong[0])}; values must be finite numbers"
        if len(words) != width:
            cut = "; the file is cut off: remove this line" if frame == len(rows) > 1 else ""
            return f"{row_is} has {len(words)} values, channels are {width}{cut}"
    return "it has no frames after its frame time"
