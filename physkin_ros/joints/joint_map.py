"""Joint map file: which joint of the rig a joint of another naming drives.

A JSON object, incoming name -> rig joint name, or -> {"joint": name, "scale": 1.0, "offset": 0.0}, where the rig's
position is scale * incoming + offset [rad]; a scale of -1 turns the sense of rotation round.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from physkin_ros.joints.nearest_names import nearest_names

__all__ = ["JointMapError", "MappedJoint", "load_joint_map"]

ENTRY_KEYS = ("joint", "scale", "offset")


class JointMapError(ValueError):
    """A joint map file cannot be read, or does not fit the rig."""


@dataclass(frozen=True)
class MappedJoint:
    """Rig joint that an incoming joint drives: position = scale * incoming + offset [rad]."""

    joint: str
    scale: float = 1.0
    offset: float = 0.0


def load_joint_map(path: str | Path, joint_names: Collection[str]) -> dict[str, MappedJoint]:
    """Read a joint map for a rig with joints `joint_names`; the result is keyed by incoming name.

    Raises JointMapError naming the file and the entry: unreadable, not an object, unknown key, a joint the rig does not
    have or that two entries drive, a scale or offset that is not a finite number, a scale of zero.
    """
    try:
        entries = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise JointMapError(f"cannot read joint map {path}: {error}") from error
    if not isinstance(entries, dict):
        raise JointMapError(f"joint map {path} must be a JSON object, incoming name to rig joint, got {_kind(entries)}")
    mapped: dict[str, MappedJoint] = {}
    for name, entry in entries.items():
        try:
            mapped[name] = _mapped_joint(entry, joint_names)
        except JointMapError as error:
            raise JointMapError(f"joint map {path}, entry {name!r}: {error}") from None
    driven = [entry.joint for entry in mapped.values()]
    if twice := sorted({joint for joint in driven if driven.count(joint) > 1}):
        raise JointMapError(f"joint map {path}: two entries drive {', '.join(twice)}; a rig joint takes one")
    return mapped


def _mapped_joint(entry: object, joint_names: Collection[str]) -> MappedJoint:
    if isinstance(entry, str):
        entry = {"joint": entry}
    if not isinstance(entry, dict):
        raise JointMapError(f"must be a rig joint name or an object, got {_kind(entry)}")
    if unknown := sorted(set(entry) - set(ENTRY_KEYS)):
        raise JointMapError(f"unknown key {', '.join(map(repr, unknown))}; allowed: {', '.join(ENTRY_KEYS)}")
    if entry.get("joint") not in joint_names:
        near = nearest_names(str(entry.get("joint")), joint_names)
        hint = f"did you mean {near}?" if near else "physkin info tshirt lists the joints of the default rig"
        raise JointMapError(f"the rig has no joint {entry.get('joint')!r}; {hint}")
    numbers = {key: entry[key] for key in ("scale", "offset") if key in entry}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise JointMapError(f"{key} must be a finite number, got {value!r}")
    if numbers.get("scale") == 0:
        raise JointMapError("scale must not be zero")
    return MappedJoint(entry["joint"], **{key: float(value) for key, value in numbers.items()})


def _kind(value: object) -> str:
    return {"list": "an array", "NoneType": "null", "str": "a string", "dict": "an object"}.get(
        type(value).__name__, f"{value!r}"
    )
