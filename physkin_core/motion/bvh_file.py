"""BVH files: a tree of joints, then a row of numbers for each frame; keywords in any case, on one line or many.

Dimensions: `T` frames. Lengths in the file's own unit, angles in degrees.
"""

from __future__ import annotations

import logging
import re
from array import array
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError, numbers_of, shown, with_decimal_points
from physkin_core.motion.source_clip import MOST_JOINTS, SourceClip, check_clip_size, posed_clip

__all__ = ["read_bvh"]

log = logging.getLogger(__name__)

FRAME_TIMES = (1e-5, 10.0)  # [s]
COMMENT = re.compile(r"^\s*(#|//).*|\s(#|//)\s.*")
CHANNEL = re.compile(r"([XYZ])_?(ROT|POS|SCA)[A-Z]*", re.IGNORECASE)
HEADING = re.compile(r"(frames|frame[\s_]*time)[\s:=]*([^\s:=]+)", re.IGNORECASE)


class _Entry(NamedTuple):
    """A joint of the tree. channels: axis, an index, and kind, ROT, POS or SCA, of each of its columns."""

    name: str
    parent: int
    offset: list[float]
    channels: list[tuple[int, str]]


def read_bvh(text: str, *, name: str = "BVH") -> SourceClip:
    """The clip of a text. The offset of a joint that has positions of its own is that of the first frame.

    name: in the warning that it says another number of frames than it has. Raises ContentError, with the line, and for
    a clip that is too long or too large.
    """
    lines = enumerate(text.split("\n"), 1)
    tree = _tree(lines)
    said, step, frames = _frames(lines, sum(len(entry.channels) for entry in tree))
    if said != str(len(frames)):
        log.warning("%s: it says that it has %s frames; the %d that it has are taken", name, shown(said), len(frames))
    check_clip_size(len(frames), len(tree), 1 / step)
    names, parents, offsets, _ = zip(*tree)
    offsets, turns, places, column = np.array(offsets), [], {}, 0
    for joint, entry in enumerate(tree):
        if any(kind == "POS" for _, kind in entry.channels):
            places[joint] = np.tile(offsets[joint], (len(frames), 1))
        order, columns = "", []
        for axis, kind in entry.channels:
            if kind == "POS":
                places[joint][:, axis] = frames[:, column]
            elif kind == "ROT":
                order, columns = order + "XYZ"[axis], [*columns, column]
            column += 1
        turn = Rotation.from_euler(order, frames[:, columns], degrees=True) if order else Rotation.identity(len(frames))
        turns.append(turn)
    moving = [joint for joint in places if parents[joint] >= 0]
    firsts = np.array([places[joint][0] for joint in moving]).reshape(-1, 3)
    lengths = np.linalg.norm(firsts, axis=1) @ np.linalg.norm(offsets[moving], axis=1)
    # Positions that replace offsets, as in most files, lie along them; others are added.
    if (firsts * offsets[moving]).sum() <= lengths / 2:
        for joint in moving:
            places[joint] += offsets[joint]
    for joint in moving:
        offsets[joint] = places[joint][0]
    return posed_clip(names, parents, offsets, turns, places, len(frames), 1 / step)


def _tree(lines: Iterator[tuple[int, str]]) -> list[_Entry]:
    """The joints, parents first; takes the lines up to MOTION."""
    tree: list[_Entry] = []
    braces: list[int | None] = []  # joints, None for an End Site
    current: int | None = None
    for number, line in lines:
        words = deque(re.sub("([{}])", r" \1 ", with_decimal_points(COMMENT.sub("", line))).split())
        while words:
            word = words.popleft()
            keyword = word.upper()
            if keyword in ("ROOT", "JOINT", "END", "ENDSITE"):
                name = []
                while words and words[0] != "{":
                    name.append(words.popleft())
                current = None
                if keyword in ("ROOT", "JOINT") and None not in braces:
                    current = len(tree)
                    tree.append(_Entry(" ".join(name), braces[-1] if braces else -1, [0.0] * 3, []))
                if len(tree) > MOST_JOINTS:
                    raise ContentError(f"line {number}: it has over {MOST_JOINTS} joints, which is the most allowed")
            elif keyword == "OFFSET":
                offset = numbers_of([words.popleft() for _ in range(min(3, len(words)))], 3, number)
                if current is not None:
                    tree[current].offset[:] = offset
            elif keyword == "CHANNELS" and words and words[0].isdecimal():
                words.popleft()  # their names count
            elif current is not None and (match := CHANNEL.fullmatch(word)):
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
                raise ContentError(
                    f"line {number}: {shown(word)} cannot stand within {len(braces)} open braces; allowed are ROOT, "
                    "JOINT, End Site, OFFSET, CHANNELS, { and }, and MOTION after all"
                )
    raise ContentError("it has no line MOTION after a tree of joints: it is cut off, or no BVH")


def _frames(lines: Iterator[tuple[int, str]], width: int) -> tuple[str, float, np.ndarray]:
    """How many frames there are as it says, their time step [s] and values (T, width)."""
    said, values = {}, array("d")
    for number, line in lines:
        if not values and (headings := HEADING.findall(line)):
            said |= {"time" if "time" in key.lower() else "frames": value for key, value in headings}
        elif words := with_decimal_points(COMMENT.sub("", line)).split():
            values.extend(numbers_of(words, width, number))
    try:
        step = float(with_decimal_points(said["time"]))
    except (KeyError, ValueError):
        raise ContentError(f"'Frame Time: SECONDS' must follow MOTION, got {shown(said.get('time', 'none'))}") from None
    if not FRAME_TIMES[0] <= step <= FRAME_TIMES[1]:
        raise ContentError(f"its frame time is {step:g} s, allowed are {FRAME_TIMES[0]:g} to {FRAME_TIMES[1]:g} s")
    if not values:
        raise ContentError("it has no frames after its frame time")
    return said.get("frames", "no"), step, np.array(values).reshape(-1, width)
