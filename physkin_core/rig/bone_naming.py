"""Which joint of an avatar's skeleton is which bone of the garment model's rig, by name.

Joints may bear the rig's own names, or those of a file `{"naming": title, "bones": {joint: rig bone}}` in `bone_maps/`,
of which the first that a skeleton has counts for a bone. Names are compared without case, separators, namespace and
tools' prefixes, wherever the side stands: `mixamorig:LeftArm`, `leftArm`, `DEF-arm.L` and `L_Arm` are one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from physkin_core.file_reading import shown
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS
from physkin_core.rig.rig import Rig, RigError

__all__ = ["BONE_MAPS", "OWN_NAMES", "limb_joints", "missing_bones", "named_bones", "required_bones"]

BONE_MAPS = Path(__file__).parent / "bone_maps"
OWN_NAMES = "the rig's own names"
VRM_MAP = "vrm"
LISTED_NAMES = 3
"""Of each kind, in an error."""
PREFIXES = {"mixamorig", "def", "bip", "cc", "base", "valve", "j", "c", "m", "f", "avg"}
"""Words that tools put before every joint's name."""
SIDES = {"l": "l", "left": "l", "r": "r", "right": "r"}
LIMBS = {"arm": "arm", "arms": "arm", "leg": "leg", "legs": "leg"}


def required_bones(rig: Rig) -> tuple[str, ...]:
    """Bones every skeleton must have a joint for: the ends of the limb segments; all of them on a rig without these."""
    limbs = dict.fromkeys(name for segment in LIMB_SEGMENTS.values() for name in segment)
    return tuple(name for name in limbs if name in rig.bone_names) or rig.bone_names


def missing_bones(found: Mapping[str, int], joint_names: Sequence[str], rig: Rig, *, source: str) -> RigError:
    """The error that says which required bones are not among those found (joint by rig bone), which joints were taken
    for those that are, and which are not known."""
    required = required_bones(rig)
    missing = [name for name in required if name not in found]
    taken = [f"{shown(joint_names[joint])} as {bone}" for bone, joint in found.items() if joint < len(joint_names)]
    others = [shown(name) for joint, name in enumerate(joint_names) if joint not in found.values()]
    return RigError(
        f"avatar {source}: no joint for {len(missing)} of the {len(required)} rig bones it must have: "
        f"{_some(missing)}; taken: {_some(taken)}; not recognised: {_some(others)}. Name joints as the rig, Mixamo, "
        "VRM or Unreal do"
    )


def _some(texts: Sequence[str]) -> str:
    more = f" and {len(texts) - LISTED_NAMES} more" if len(texts) > LISTED_NAMES else ""
    return (", ".join(texts[:LISTED_NAMES]) or "none") + more


def named_bones(
    joint_names: Sequence[str], rig: Rig, *, humanoid: Mapping[str, int] | None = None
) -> tuple[dict[str, int], str]:
    """Joint index by rig bone, by the naming that fits best, and that naming; required bones may be missing.

    joint_names: of the avatar. humanoid: joint index by VRM humanoid bone; replaces the names where a file has it.
    """
    if humanoid is not None:
        naming, bones = _bone_maps()[VRM_MAP]
        candidates = [(naming, {bones[role]: joint for role, joint in humanoid.items() if role in bones})]
    else:
        namings = [(OWN_NAMES, {name: name for name in rig.bone_names}), *_bone_maps().values()]
        numberless = [re.sub(r"_\d+$", "", name) for name in joint_names]  # exporters number joints
        tables = [_by_plain_name(names) for names in (joint_names, numberless)]
        candidates = [(naming, _look_up(joints, bones)) for joints in tables for naming, bones in namings]
    required = required_bones(rig)
    naming, found = max(
        candidates, key=lambda each: (sum(name in each[1] for name in required), len(each[1].keys() & rig.bone_names))
    )
    return {bone: joint for bone, joint in found.items() if bone in rig.bone_names}, naming


def limb_joints(joint_names: Sequence[str]) -> dict[tuple[str, str], list[int]]:
    """Joints by limb ("arm" or "leg") and side ("L" or "R"), of names that say both, such as `leg_joint_L_1`."""
    found: dict[tuple[str, str], list[int]] = {}
    for joint, words in enumerate(map(_words, joint_names)):
        limbs, sides = ({table[word] for word in words if word in table} for table in (LIMBS, SIDES))
        if len(limbs) == len(sides) == 1:
            found.setdefault((*limbs, sides.pop().upper()), []).append(joint)
    return found


@cache
def _bone_maps() -> dict[str, tuple[str, dict[str, str]]]:
    """Title and rig bone by joint name of every file in `bone_maps/`, by file name."""
    files = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(BONE_MAPS.glob("*.json"))}
    return {stem: (data["naming"], data["bones"]) for stem, data in files.items()}


def _look_up(joints: Mapping[str, int], bones: Mapping[str, str]) -> dict[str, int]:
    found: dict[str, int] = {}
    for name, bone in bones.items():
        if _plain(name) in joints:
            found.setdefault(bone, joints[_plain(name)])
    return found


def _by_plain_name(names: Sequence[str]) -> dict[str, int]:
    joints: dict[str, int] = {}
    for joint, name in enumerate(names):
        joints.setdefault(_plain(name), joint)
    return joints


@cache
def _plain(name: str) -> str:
    """A name in one spelling: lower case, without separators, namespace and prefixes, its side at the end."""
    words = _words(name)
    first = 0
    while first < len(words) - 1 and (words[first] in PREFIXES or first and words[first].isdigit()):
        first += 1
    words = words[first:] or words
    side = next((word for word in words if word in SIDES), None)
    if side is not None:
        words.remove(side)
    return "".join(words) + f".{SIDES.get(side, '')}"


def _words(name: str) -> list[str]:
    """Lower-case words and numbers of a name, without its namespace."""
    last = re.sub(r"^(left|right)(?=[a-z])", r"\1 ", re.split(r"[:|/]", name)[-1])
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", last)]
