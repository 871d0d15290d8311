"""Skeletons of motion capture, a tree of joints with offsets at rest and a rotation each a frame; ASF/AMC files.

Dimensions: `T` frames, `J` joints. Lengths in the file's own unit, angles in degrees.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError, shown, with_decimal_points
from physkin_core.motion.source_clip import MOST_JOINTS, SourceClip, posed_clip

__all__ = ["Joint", "Skeleton", "numbers_of", "read_amc"]

NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?", re.IGNORECASE)
NO_TURN = Rotation.identity()


@dataclass(frozen=True)
class Joint:
    """A joint in the file's axes.

    parent: index of a joint before it, -1 for the root. offset: (3,) from the parent at rest. order: axes of its
    rotation, each about what the one before has turned, such as "ZXY". angles: (T, len(order)) [degrees].
    places: (T, 3) instead of the offset where it moves; None where it does not. axes: those that `order` means.
    """

    name: str
    parent: int
    offset: np.ndarray
    order: str
    angles: np.ndarray
    places: np.ndarray | None = None
    axes: Rotation = NO_TURN

    def turns(self) -> Rotation:
        """(T) on the parent."""
        if not self.order:
            return Rotation.identity(len(self.angles))
        return self.axes * Rotation.from_euler(self.order, self.angles, degrees=True) * self.axes.inv()


@dataclass(frozen=True)
class Skeleton:
    """Joints, parents first, that all have T frames."""

    joints: tuple[Joint, ...]
    rate_hz: float

    def clip(self) -> SourceClip:
        """All joints, posed. Raises ContentError for a clip that is too long or too large."""
        names, parents, offsets = zip(*((each.name, each.parent, each.offset) for each in self.joints))
        places = {index: each.places for index, each in enumerate(self.joints) if each.places is not None}
        count = len(self.joints[0].angles)
        return posed_clip(names, parents, offsets, (each.turns() for each in self.joints), places, count, self.rate_hz)


def read_amc(text: str, asf: str, rate_hz: float) -> Skeleton:
    """An AMC file with its skeleton. Raises ContentError, with the line of the AMC, ValueError, IndexError or
    KeyError where one is none."""
    bones: dict[str, dict[str, list[str]]] = {"root": {}}
    for block in asf.partition(":bonedata")[2].partition(":hierarchy")[0].split("begin")[1:]:
        words = [with_decimal_points(line).split() for line in block.split("\n") if line.strip()]
        fields = {keyword.lower(): values for keyword, *values in filter(None, words)}
        if lacking := [key for key in ("name", "direction", "length", "axis") if not fields.get(key)]:
            raise ContentError(
                f"its skeleton's bone {shown(' '.join(fields.get('name', ['?'])))} lacks {', '.join(lacking)}"
            )
        bones[fields["name"][0]] = fields
    _check_joint_count(len(bones))
    parent_of = _parents(asf.partition(":hierarchy")[2], bones)
    order = asf.partition(":root")[2].partition("order")[2].split("\n")[0].upper().split()
    channels_of = {name: bones[name].get("dof", []) if parent else order for name, parent in parent_of.items()}
    frames = {name: array("d") for name, channels in channels_of.items() if channels}
    count = 0
    for number, line in enumerate(text.split("\n"), 1):
        name, *words = with_decimal_points(line).split() or [""]
        if name in frames:
            frames[name].extend(numbers_of(words, len(channels_of[name]), number))
        elif not words and name.isdigit():
            count += 1
    index = {name: k for k, name in enumerate(parent_of)}
    joints = []
    for name, parent in parent_of.items():
        fields = bones[name]
        channels = channels_of[name]
        if channels:
            values = np.array(frames[name]).reshape(-1, len(channels))
            if not len(values) == count > 0:
                raise ContentError(
                    f"{shown(name)} has values in {len(values)} of {count} frames, expected all, and some"
                )
        if not parent:
            turns, places = ([order.index(f"{kind}{axis}") for axis in "XYZ"] for kind in "RT")
            joints.append(Joint(name, -1, np.zeros(3), "ZYX", values[:, turns[::-1]], values[:, places]))
            continue
        axes = Rotation.from_euler(fields["axis"][3].lower(), [float(v) for v in fields["axis"][:3]], degrees=True)
        carrier = bones[parent] if parent != "root" else None  # a bone starts where its parent ends
        offset = np.array([float(v) for v in carrier["direction"]]) * float(carrier["length"][0]) if carrier else 0.0
        letters = "".join(channel[1].upper() for channel in channels)
        angles = values[:, ::-1] if channels else np.empty((count, 0))
        joints.append(Joint(name, index[parent], offset + np.zeros(3), letters[::-1], angles, axes=axes))
    return Skeleton(tuple(joints), rate_hz)


def numbers_of(words: Sequence[str], count: int, line: int) -> list[float]:
    """The `count` finite numbers that words of a line are. Raises ContentError, naming it, where they are not."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        wrong = next((word for word in words if not NUMBER.fullmatch(word)), f"{len(words)} values")
        raise ContentError(f"line {line} has {shown(wrong)}; allowed are {count} finite numbers")
    return numbers


def _parents(hierarchy: str, bones: Collection[str]) -> dict[str, str]:
    """The parent of each bone by name, parents first; that of the root is empty."""
    parent_of = {"root": ""}
    for line in hierarchy.split("\n"):
        parent, *children = line.split() or [""]
        if parent not in bones:
            continue
        if parent not in parent_of:
            raise ContentError(f"its hierarchy hangs bones on {shown(parent)}, which no line before hangs on another")
        for child in children:
            if child not in bones or child in parent_of:
                raise ContentError(
                    f"its hierarchy hangs {shown(child)} on {shown(parent)}; allowed are bones of :bonedata, each "
                    "once, and no circle"
                )
            parent_of[child] = parent
    return parent_of


def _check_joint_count(count: int) -> None:
    if count > MOST_JOINTS:
        raise ContentError(f"it has {count} joints, allowed are {MOST_JOINTS}")
