"""What the name of a joint says: which bones of the rig it may be, on which side, and of which limb.

Names are compared without case, separators, namespace and tools' prefixes, wherever the side stands:
`mixamorig:LeftArm`, `leftArm`, `DEF-arm.L` and `L_Arm` are one. `bone_names.json` has the words for each bone, without
its side: first those that mean nothing else, then those that mean another bone in most skeletons (SMPL's shoulder is an
upper arm, SOMA's leg a thigh).
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path

__all__ = ["JointName", "plain_name", "read_name", "without_common_words"]

PREFIXES = set("mixamorig def bip biped cc base valve j c m f avg character".split())
"""Words that tools put before every joint's name."""
SIDES = {"l": "L", "left": "L", "lf": "L", "lft": "L", "r": "R", "right": "R", "rt": "R", "rgt": "R"}
LIMBS = {"arm": "arm", "arms": "arm", "leg": "leg", "legs": "leg"}
COMMON = 0.6
"""Share of joints whose names begin alike from which on that is no part of a name."""
SECOND_CHOICE = 1.0
NUMBERED = 0.3
"""Of a name that is known without the number that an exporter or Blender put behind it, `_12` or `.001`."""


@dataclass(frozen=True)
class JointName:
    """bones: cost of each bone, without its side, that the name may mean. side: "L", "R" or "". limb: "arm", "leg" or
    "", where no bone's name is known."""

    bones: Mapping[str, float] = field(default_factory=dict)
    side: str = ""
    limb: str = ""


@lru_cache(1 << 14)
def read_name(name: str) -> JointName:
    """What a joint's name says; nothing of names that say nothing."""
    known = _bones_by_name()
    for cost, each in ((0.0, name), (NUMBERED, re.sub(r"[_.]\d+$", "", name))):
        words, side = _words(each)
        spelling = "".join(words)
        if spelling in known:
            return JointName({bone: cost + more for bone, more in known[spelling].items()}, side)
        if not side and spelling[:1] in SIDES and spelling[1:] in known:  # AMC says `lfemur`
            return JointName({bone: cost + more for bone, more in known[spelling[1:]].items()}, SIDES[spelling[0]])
    limbs = {LIMBS[word] for word in words if word in LIMBS}
    return JointName(side=side, limb=limbs.pop() if len(limbs) == 1 and side else "")


def without_common_words(names: Sequence[str]) -> list[str]:
    """Names without first and last words that most of them have in common, such as the figure's own name."""
    for word in (r"^[^\W_]+[\W_]+(?=\w)", r"(?<=\w)_[^\W_]+$") * 2:
        found = [match[0] if (match := re.search(word, name)) else "" for name in names]
        common = {each for each, count in Counter(found).items() if count > COMMON * len(names)}
        names = [re.sub(word, "", name) if each in common else name for name, each in zip(names, found)]
    return list(names)


def plain_name(name: str) -> str:
    """A name in one spelling: lower case, without separators, namespace and prefixes, its side at the end."""
    words, side = _words(name)
    return f"{''.join(words)}.{side}"


@cache
def _bones_by_name() -> dict[str, dict[str, float]]:
    """Cost by bone of every name that is known, in one word."""
    table = json.loads(Path(__file__).with_name("bone_names.json").read_text(encoding="utf-8"))
    found: dict[str, dict[str, float]] = {}
    for bone, choices in table.items():
        for rank, names in enumerate(choices):
            for name in (bone, *names):
                found.setdefault(name.replace("_", ""), {}).setdefault(bone, rank * SECOND_CHOICE)
    return found


def _words(name: str) -> tuple[list[str], str]:
    """Lower-case words and numbers of a name, without namespace, prefixes and side; and the side, "L", "R" or ""."""
    last = re.split(r"[:|/]", unicodedata.normalize("NFKC", name).replace("左", "left ").replace("右", "right "))[-1]
    last = last.lower() if last.isupper() else re.sub(r"^([LR])(?=[A-Z]{1,2}[a-z])", r"\1 ", last)
    last = re.sub(r"^(left|right)(?=[a-z])", r"\1 ", last)
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|[^\W\d_A-Za-z]+", last)]
    first = 0
    while first < len(words) - 1 and (words[first] in PREFIXES or (first and words[first].isdigit())):
        first += 1
    words = words[first:]
    side = next((word for word in words if word in SIDES), None)
    if side is None:
        return words, ""
    words.remove(side)
    return words, SIDES[side]
