"""Joint map file: which joint of the rig a joint of another naming drives.

A JSON object, incoming name -> rig joint name, or -> {"joint": name, "scale": 1.0, "offset": 0.0}, where the rig's
position is scale * incoming + offset [rad]; a scale of -1 turns the sense of rotation round.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from physkin_core.file_reading import ContentError, read_bytes, read_json, reading, shown
from physkin_core.rig.nearest_names import nearest_names

__all__ = ["JointMapError", "MappedJoint", "load_joint_map"]

LARGEST_MAP = 1 << 20  # [bytes]
LONGEST_NAME = 100  # [characters] that a hint is looked for
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
    with reading(f"joint map {path}", JointMapError):
        return _mapped_joints(read_json(read_bytes(Path(path), most=LARGEST_MAP)), joint_names)


def _mapped_joints(entries: object, joint_names: Collection[str]) -> dict[str, MappedJoint]:
    if not isinstance(entries, dict):
        raise ContentError(f"it must be a JSON object, incoming name to rig joint, got {_kind(entries)}")
    mapped: dict[str, MappedJoint] = {}
    for name, entry in entries.items():
        try:
            mapped[name] = _mapped_joint(entry, joint_names)
        except ContentError as error:
            raise ContentError(f"entry {shown(name)}: {error}") from None
    driven = Counter(entry.joint for entry in mapped.values())
    if twice := sorted(joint for joint, times in driven.items() if times > 1):
        raise ContentError(f"two entries drive {', '.join(twice)}; a rig joint takes one")
    return mapped


def _mapped_joint(entry: object, joint_names: Collection[str]) -> MappedJoint:
    if isinstance(entry, str):
        entry = {"joint": entry}
    if not isinstance(entry, dict):
        raise ContentError(f"must be a rig joint name or an object, got {_kind(entry)}")
    if unknown := sorted(set(entry) - set(ENTRY_KEYS)):
        raise ContentError(f"unknown key {', '.join(map(shown, unknown))}; allowed: {', '.join(ENTRY_KEYS)}")
    if entry.get("joint") not in joint_names:
        near = nearest_names(str(entry.get("joint"))[:LONGEST_NAME], joint_names)
        hint = f"did you mean {near}?" if near else "physkin info tshirt lists the joints of the default rig"
        raise ContentError(f"the rig has no joint {shown(entry.get('joint'))}; {hint}")
    numbers = {key: entry[key] for key in ("scale", "offset") if key in entry}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ContentError(f"{key} must be a finite number, got {shown(value)}")
    if numbers.get("scale") == 0:
        raise ContentError("scale must not be zero")
    return MappedJoint(entry["joint"], **{key: float(value) for key, value in numbers.items()})


def _kind(value: object) -> str:
    return {"list": "an array", "NoneType": "null", "str": "a string", "dict": "an object"}.get(
        type(value).__name__, shown(value)
    )
