"""Rig file: the skeleton of a mesh whose own format has none, `NAME.rig.json` beside `NAME.obj`.

JSON; every key may be left out:
    bones: [{"name", "parent" (index or name, -1 or null for the root), "head": [x, y, z], "tail": [x, y, z]}, ...],
        in the mesh's own frame and unit; a rig saved by `Rig.to_json` fits.
    influence_bones, influence_weights: one list a vertex, in the order of the mesh file; indices into `bones`.
    up, forward: axes of the mesh, such as "Y" and "Z" or "-Y". scale: metres per unit. Guessed where left out.

Dimensions: `V` vertices, `K` influences.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.skinned_mesh import check_bone_count, check_influence_count
from physkin_core.file_reading import ContentError, listed, read_bytes, read_json, reading, shown

__all__ = ["AXES", "RigFile", "axes_to_root_frame", "read_rig_file"]

RIG_FILE_KEYS = ("bones", "dofs", "influence_bones", "influence_weights", "up", "forward", "scale")
AXES = {sign + axis: (-1 if sign else 1) * np.eye(3)["XYZ".index(axis)] for axis in "XYZ" for sign in ("", "-")}
FORWARD = {"X": "Y", "Y": "Z", "Z": "X"}
"""Of a mesh whose up axis alone is known, as tools have it."""


LARGEST_RIG_FILE = 1 << 26  # [bytes]


@dataclass(frozen=True)
class RigFile:
    """A checked rig file, or none.

    bones: (name, parent index, head (3,), tail (3,)) each. influences: (V, K) twice, or None. up, forward, scale: None
    where the file does not say.
    """

    bones: tuple[tuple[str, int, np.ndarray, np.ndarray], ...] = ()
    influences: tuple[np.ndarray, np.ndarray] | None = None
    up: str | None = None
    forward: str | None = None
    scale: float | None = None


def read_rig_file(path: Path) -> RigFile:
    """Raises AvatarError naming the entry that is wrong and what was allowed."""
    with reading(f"rig file {path}", AvatarError):
        return _checked(read_json(read_bytes(path, most=LARGEST_RIG_FILE)))


def _checked(data: object) -> RigFile:
    if not isinstance(data, dict):
        raise ContentError(f"it holds {shown(data)}, it must be a JSON object")
    if unknown := sorted(set(data) - set(RIG_FILE_KEYS)):
        raise ContentError(f"unknown keys {listed(unknown)}; allowed: {', '.join(RIG_FILE_KEYS)}")
    bones = _bones(data.get("bones", []))
    influences = _influences(data, len(bones))
    scale = float(data["scale"]) if "scale" in data else None
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise ContentError(f"scale is {scale}, allowed are positive numbers")
    if "forward" in data and "up" not in data:
        raise ContentError("it says what is forward, but not what is up; forward goes with up")
    up, forward = (str(data[key]).upper() if key in data else None for key in ("up", "forward"))
    if up is not None and (up not in AXES or forward not in (None, *AXES) or forward and up[-1] == forward[-1]):
        allowed = f"allowed are two different axes of {', '.join(AXES)}"
        raise ContentError(f"up {shown(up)} and forward {shown(forward)}; {allowed}")
    return RigFile(bones, influences, up, forward, scale)


def _bones(entries: list) -> tuple:
    check_bone_count(len(entries))
    names, bones = [str(entry["name"]) for entry in entries], []
    for index, entry in enumerate(entries):
        name, parent = shown(names[index]), entry["parent"]
        parent = names.index(parent) if isinstance(parent, str) else -1 if parent is None else int(parent)
        head, tail = (np.array(entry[key], dtype=np.float64) for key in ("head", "tail"))
        if not -1 <= parent < index:
            raise ContentError(f"bone {name} has parent {shown(parent)}; a parent must come first")
        if head.shape != (3,) or tail.shape != (3,) or not (np.isfinite(head).all() and np.isfinite(tail).all()):
            raise ContentError(f"head and tail of bone {name} must be 3 finite numbers")
        bones.append((names[index], parent, head, tail))
    return tuple(bones)


def _influences(data: dict, bone_count: int) -> tuple[np.ndarray, np.ndarray] | None:
    given = [data.get(key) for key in ("influence_bones", "influence_weights")]
    if given == [None, None]:
        return None
    if None in given or bone_count == 0:
        raise ContentError("bones, influence_bones and influence_weights come together or not at all")
    width = max((len(row) for row in given[0]), default=0)
    if width == 0 or [len(row) for row in given[0]] != [len(row) for row in given[1]]:
        raise ContentError("influence_bones and influence_weights must have rows of equal length")
    check_influence_count(width)
    bones = np.array([[*row, *[0] * (width - len(row))] for row in given[0]], dtype=np.int64)
    weights = np.array([[*row, *[0.0] * (width - len(row))] for row in given[1]], dtype=np.float64)
    if bones.min() < 0 or bones.max() >= bone_count:
        raise ContentError(f"influence_bones span {bones.min()} to {bones.max()}, allowed 0 to {bone_count - 1}")
    total = weights.sum(axis=1, keepdims=True)
    if not np.isfinite(weights).all() or weights.min() < 0 or total.min() <= 0:
        raise ContentError("skinning weights must be finite, not negative, not all zero for a vertex")
    return bones, weights / total


def axes_to_root_frame(up: str, forward: str | None = None) -> np.ndarray:
    """(3, 3) from a mesh's axes, such as "Y" and "-Z", to the root frame; forward: None for what goes with `up`."""
    upward, ahead = AXES[up], AXES[forward or FORWARD[up[-1]]]
    return np.stack([ahead, np.cross(upward, ahead), upward])
