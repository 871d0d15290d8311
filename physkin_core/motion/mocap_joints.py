"""Which joint of a motion capture skeleton is which of a body's, by the usual names.

Head and limbs are found by name, written without case, separators and namespace, with their side before or after:
`lShldr`, `LeftArm`, `mixamorig:LeftArm`, `UpperArm_L`, `left_shoulder`. Pelvis and chest are where legs and arms
branch.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from physkin_core.motion.mocap_files import Skeleton
from physkin_core.motion.motion import MotionError

__all__ = ["find_joints"]

HEAD_NAMES = ("head", "neck1", "neck")
# In order of preference: a name that means another joint elsewhere comes last (SMPL's foot is a toe, SOMA's leg a
# thigh, Mixamo's shoulder a collarbone). A joint is one part only, hence knees before hips.
LIMB_NAMES = {
    "knee": ("shin", "lowerleg", "lowleg", "tibia", "calf", "knee", "leg"),
    "hip": ("upleg", "upperleg", "femur", "thigh", "hip", "leg"),
    "ankle": ("ankle", "foot"),
    "elbow": ("forearm", "lowerarm", "lowarm", "radius", "elbow"),
    "shoulder": ("upperarm", "uparm", "humerus", "shldr", "arm", "shoulder"),
    "wrist": ("wrist", "hand"),
}
SIDED = ("{side}{name}", "{s}{name}", "{name}{s}", "{name}{side}")
CHAINS = (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist"))


def find_joints(skeleton: Skeleton) -> dict[str, int]:
    """Joint index of `root`, `chest`, `neck`, and `hip`, `knee`, `ankle`, `shoulder`, `elbow`, `wrist` with `.L`, `.R`.

    Raises MotionError for a part that no joint has a name of, naming those tried and the joints there are, and for
    limbs whose joints do not follow each other.
    """
    names = [joint.name for joint in skeleton.joints]
    plain = [_plain(name) for name in names]
    found: dict[str, int] = {}

    def find(part: str, wanted: Sequence[str], forms: Sequence[str] = ("{name}",), **sides: str) -> None:
        for name in (form.format(name=name, **sides) for name in wanted for form in forms):
            index = next((k for k, its in enumerate(plain) if its == name and k not in found.values()), None)
            if index is not None:
                found[part] = index
                return
        sided = f" with {' or '.join(sides.values())} before or after" if sides else ""
        raise MotionError(f"no joint called {', '.join(wanted)}{sided}, for {part}; it has {', '.join(names)}")

    find("neck", HEAD_NAMES)
    for s, side in (("l", "left"), ("r", "right")):
        for part, wanted in LIMB_NAMES.items():
            find(f"{part}.{s.upper()}", wanted, SIDED, side=side, s=s)
    for side in "LR":
        for upper, middle, end in CHAINS:
            limb = [found[f"{part}.{side}"] for part in (upper, middle, end)]
            if not set(limb) <= set(skeleton.ancestors(limb[-1])) or limb != sorted(limb):
                raise MotionError(f"joints {', '.join(names[k] for k in limb)} are no limb: one must carry the next")
    found["root"] = _branching(skeleton, found["hip.L"], found["hip.R"])
    found["chest"] = _branching(skeleton, found["shoulder.L"], found["shoulder.R"])
    while plain[found["chest"]].startswith("neck"):  # 3ds Max's bipeds hang their collarbones on it
        found["chest"] = skeleton.joints[found["chest"]].parent
    return found


def _branching(skeleton: Skeleton, first: int, second: int) -> int:
    """The last joint that carries both."""
    return max(set(skeleton.ancestors(first)) & set(skeleton.ancestors(second)))


def _plain(name: str) -> str:
    """A joint's name without case, separators and namespace; sides stay where they are, for AMC says `lfemur`."""
    last = re.split(r"[:|/]", name)[-1].lower()
    return re.sub(r"[^a-z0-9]", "", re.sub(r"^(mixamorig\d*|bip0*1)", "", last))
