"""Which joint of an avatar's skeleton is which bone of the garment model's rig, by name.

Joints may bear the rig's own names, or those of a file `{"naming": title, "bones": {joint: rig bone}}` in `bone_maps/`.
Names are compared without case, separators and namespace: `mixamorig:LeftArm`, `leftArm` and `Left_Arm` are one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from physkin_core.rig.canonical_pose import LIMB_SEGMENTS
from physkin_core.rig.rig import Rig, RigError

__all__ = ["BONE_MAPS", "OWN_NAMES", "match_bones", "plain_name", "required_bones"]

BONE_MAPS = Path(__file__).parent / "bone_maps"
OWN_NAMES = "the rig's own names"
VRM_MAP = "vrm"
LISTED_NAMES = 60


def required_bones(rig: Rig) -> tuple[str, ...]:
    """Bones every skeleton must have a joint for: the ends of the limb segments; all of them on a rig without these."""
    limbs = dict.fromkeys(name for segment in LIMB_SEGMENTS.values() for name in segment)
    return tuple(name for name in limbs if name in rig.bone_names) or rig.bone_names


def match_bones(
    joint_names: Sequence[str], rig: Rig, *, source: str, humanoid: Mapping[str, int] | None = None
) -> tuple[dict[str, int], str]:
    """Joint index by rig bone, and the naming that led there.

    joint_names: of the avatar. humanoid: joint index by VRM humanoid bone; replaces the names where a file has it.
    Raises RigError listing the required bones that no joint was found for.
    """
    if humanoid is not None:
        naming, bones = _bone_maps()[VRM_MAP]
        candidates = [(naming, {bones[role]: joint for role, joint in humanoid.items() if role in bones})]
        present = humanoid
    else:
        joints: dict[str, int] = {}
        for joint, name in enumerate(joint_names):
            joints.setdefault(plain_name(name), joint)
        namings = [(OWN_NAMES, {name: name for name in rig.bone_names}), *_bone_maps().values()]
        candidates = [(naming, _look_up(joints, bones)) for naming, bones in namings]
        present = joint_names
    required = required_bones(rig)
    naming, found = max(candidates, key=lambda candidate: sum(name in candidate[1] for name in required))
    missing = [name for name in required if name not in found]
    if missing:
        listed = ", ".join(list(present)[:LISTED_NAMES]) + (", ..." if len(present) > LISTED_NAMES else "")
        raise RigError(
            f"avatar {source}: no joint for {len(missing)} of the {len(required)} rig bones it must have: "
            f"{', '.join(missing)}. Joints found: {listed or 'none'}. "
            f"Allowed namings: {'; '.join([OWN_NAMES, *(title for title, _ in _bone_maps().values())])}"
        )
    return {bone: joint for bone, joint in found.items() if bone in rig.bone_names}, naming


@cache
def _bone_maps() -> dict[str, tuple[str, dict[str, str]]]:
    """Title and rig bone by joint name of every file in `bone_maps/`, by file name."""
    files = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(BONE_MAPS.glob("*.json"))}
    return {stem: (data["naming"], data["bones"]) for stem, data in files.items()}


def _look_up(joints: Mapping[str, int], bones: Mapping[str, str]) -> dict[str, int]:
    found: dict[str, int] = {}
    for name, bone in bones.items():
        if plain_name(name) in joints:
            found.setdefault(bone, joints[plain_name(name)])
    return found


def plain_name(name: str) -> str:
    """A joint's name without case, separators and namespace: what names are compared by."""
    last = re.split(r"[:|/]", name)[-1].lower()
    return re.sub(r"[^a-z0-9]", "", re.sub(r"^(mixamorig\d*|bip0*1)", "", last))
