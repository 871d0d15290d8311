"""Which bones of a rig are its arms and legs, its trunk and its head, and which joints may move a limb.

Bones are recognised by their names, whatever the naming, or else by the skeleton's shape. Dimensions: `b` bones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.rig.human_skeleton import LIMB_BONES, find_human_skeleton
from physkin_core.rig.rig import Rig

__all__ = ["Limb", "Limbs", "find_limbs"]

MOST_JOINTS = 8
"""Joints of a limb that may move; a rig with more keeps those nearest to the trunk free."""
MOST_TRUNK_BONES = 4
ENDS = {
    f"{side} {kind}": tuple(f"{bone}.{side[0].upper()}" for bone in bones)
    for kind, bones in LIMB_BONES.items()
    for side in ("left", "right")
}
"""Limb -> the default rig's bones at which upper and lower segment and hand or foot begin."""


@dataclass(frozen=True)
class Limb:
    """An arm or a leg. ends: bones at whose heads upper and lower segment and hand or foot begin.

    dofs: degrees of freedom that may move it, from the trunk outwards: those of the upper segment, and the elbow's or
    knee's.
    """

    name: str
    ends: tuple[int, int, int]
    dofs: tuple[int, ...]

    @property
    def is_arm(self) -> bool:
        """Else a leg."""
        return self.name.endswith("arm")


@dataclass(frozen=True)
class Limbs:
    """What `find_limbs` found. trunk: bones that turn against each other, from the pelvis to the chest. head: or -1.

    missing: names of limbs without bones, or without joints that could move them.
    """

    limbs: tuple[Limb, ...]
    trunk: tuple[int, ...]
    head: int
    missing: tuple[str, ...]


def find_limbs(rig: Rig) -> Limbs:
    """Limbs, trunk and head of a rig. Raises ValueError for one without any arm or leg that has joints."""
    found = find_human_skeleton(rig.bone_names, rig.parents, rig.heads, load_body_model().rig).joints
    limbs, missing = [], []
    for name, wanted in ENDS.items():
        ends = tuple(found.get(bone, -1) for bone in wanted)
        chain = _chain(rig, ends[0], ends[2]) if min(ends) >= 0 else ()
        between = chain[: chain.index(ends[1]) + 1] if ends[1] in chain else ()
        dofs = tuple(k for bone in between for k in np.flatnonzero(rig.dof_bones == bone).tolist())[:MOST_JOINTS]
        if dofs:
            limbs.append(Limb(name, ends, dofs))
        else:
            missing.append(name)
    if not limbs:
        raise ValueError(
            "limbs cannot be separated: no arm or leg with joints was found in this rig, neither by the names of its "
            f"bones nor by its shape; bones are {', '.join(rig.bone_names[:60])}"
        )
    legs, arms = ([limb.ends[0] for limb in limbs if limb.is_arm == arm] for arm in (False, True))
    hub = _meeting(rig, legs) if len(legs) > 1 else 0
    chest = _meeting(rig, arms) if len(arms) > 1 else hub
    return Limbs(tuple(limbs), _trunk(rig, hub, chest), found.get("head", -1), tuple(missing))


def _trunk(rig: Rig, hub: int, chest: int) -> tuple[int, ...]:
    """At most four bones from the hub to the chest that turn by themselves."""
    turning = list(dict.fromkeys(int(rig.turns_with[bone]) for bone in (_chain(rig, hub, chest) or (hub,))))
    chosen = np.unique(np.linspace(0, len(turning) - 1, min(len(turning), MOST_TRUNK_BONES)).round().astype(int))
    return tuple(turning[at] for at in chosen)


def _chain(rig: Rig, start: int, end: int) -> tuple[int, ...]:
    """Bones from `start` down to `end`, with both; nothing if one is not below the other."""
    up = rig.ancestors(end)
    return tuple(up[: up.index(start) + 1][::-1]) if start in up else ()


def _meeting(rig: Rig, bones: list[int]) -> int:
    """The lowest bone that all of `bones` are below."""
    return max(set.intersection(*(set(rig.ancestors(bone)) for bone in bones)))
