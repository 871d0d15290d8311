"""Motion capture files, BVH and ASF/AMC: a tree of joints with offsets at rest and a rotation each a frame.

Dimensions: `T` frames, `J` joints. Lengths in the file's own unit, angles in degrees.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError, shown
from physkin_core.motion.source_clip import MOST_JOINTS, SourceClip, posed_clip

__all__ = ["Joint", "Skeleton", "read_amc", "read_bvh"]

NO_TURN = Rotation.identity()
FRAME_TIMES = (1e-5, 10.0)  # [s]


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


def read_bvh(text: str) -> Skeleton:
    """Raises ContentError, ValueError, IndexError or KeyError for text that is no BVH."""
    head, _, data = text.partition("MOTION")
    joints, channels, stack = [], [], []
    current = None  # None inside an End Site
    for line in head.splitlines():
        words = line.split()
        if not words:
            continue
        keyword = words[0].upper()
        if keyword in ("ROOT", "JOINT"):
            current = len(joints)
            joints.append((line.split(None, 1)[1].strip(), stack[-1] if stack else -1, np.zeros(3)))
            channels.append([])
        elif keyword == "END":
            current = None
        elif keyword == "OFFSET" and current is not None:
            joints[current][2][:] = [float(word) for word in words[1:4]]
        elif keyword == "CHANNELS" and current is not None:
            channels[current] = [(word[0].upper(), word[1:].lower()) for word in words[2:]]
        elif keyword == "{":
            stack.append(current)
        elif keyword == "}":
            stack.pop()
    _check_joint_count(len(joints))
    lines = [line for line in data.splitlines() if line.strip()]
    values = {" ".join(line.split(":")[0].split()): line.split(":")[1] for line in lines[:4] if ":" in line}
    count, step = int(values["Frames"]), float(values["Frame Time"])
    if not FRAME_TIMES[0] <= step <= FRAME_TIMES[1]:
        raise ContentError(f"its frame time is {step:g} s, allowed are {FRAME_TIMES[0]:g} to {FRAME_TIMES[1]:g} s")
    rows = [line for line in lines if ":" not in line]
    frames = np.loadtxt(rows, ndmin=2) if rows else np.empty((0, 0))
    width = sum(map(len, channels))
    if count == 0 or frames.shape != (count, width) or not np.isfinite(frames).all():
        raise ContentError(
            f"its frames have the shape {frames.shape}, expected {shown((count, width))}, some, and finite"
        )
    found, column = [], 0
    for (name, parent, offset), its in zip(joints, channels, strict=True):
        mine = frames[:, column : column + len(its)]
        column += len(its)
        turns = [k for k, (_, kind) in enumerate(its) if kind == "rotation"]
        places = None
        if len(turns) < len(its):
            places = np.tile(offset, (count, 1))
            for k, (axis, kind) in enumerate(its):
                if kind == "position":
                    places[:, "XYZ".index(axis)] = mine[:, k]
        found.append(Joint(name, parent, offset, "".join(its[k][0] for k in turns), mine[:, turns], places))
    return Skeleton(tuple(found), 1 / step)


def read_amc(text: str, asf: str, rate_hz: float) -> Skeleton:
    """An AMC file with its skeleton. Raises ContentError, ValueError, IndexError or KeyError where one is none."""
    bones: dict[str, dict[str, list[str]]] = {"root": {}}
    for block in asf.partition(":bonedata")[2].partition(":hierarchy")[0].split("begin")[1:]:
        fields = {line.split()[0]: line.split()[1:] for line in block.splitlines() if line.split()}
        bones[fields["name"][0]] = fields
    _check_joint_count(len(bones))
    parent_of = _parents(asf.partition(":hierarchy")[2], bones)
    order = asf.partition(":root")[2].partition("order")[2].split("\n")[0].upper().split()
    frames: dict[str, list[str]] = {name: [] for name in bones}
    count = 0
    for line in text.splitlines():
        name, _, values = line.strip().partition(" ")
        if name in frames:
            frames[name].append(values)
        elif not values and name.isdigit():
            count += 1
    index = {name: k for k, name in enumerate(parent_of)}
    joints = []
    for name, parent in parent_of.items():
        fields = bones[name]
        channels = fields.get("dof", []) if parent else order
        if channels:
            values = np.loadtxt(frames[name], ndmin=2) if frames[name] else np.empty((0, 0))
            if count == 0 or values.shape != (count, len(channels)) or not np.isfinite(values).all():
                expected = (count, len(channels))
                raise ContentError(
                    f"{shown(name)} has values of shape {values.shape}, expected {expected}, some, and finite"
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


def _parents(hierarchy: str, bones: Collection[str]) -> dict[str, str]:
    """The parent of each bone by name, parents first; that of the root is empty."""
    parent_of = {"root": ""}
    for line in hierarchy.splitlines():
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
