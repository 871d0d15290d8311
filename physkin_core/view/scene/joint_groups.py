"""Joints of a rig by the part of the body that they move, for sliders."""

from __future__ import annotations

import numpy as np

from physkin_core.rig.rig import Rig
from physkin_core.separation.limb_chains import find_limbs

__all__ = ["joint_groups"]

TRUNK, HEAD = "trunk", "head and neck"
ALL = "joints"


def joint_groups(rig: Rig) -> dict[str, list[int]]:
    """Indices of joints by trunk, head, arms and legs; all together for a rig without limbs that can be told."""
    try:
        limbs = find_limbs(rig).limbs
    except ValueError:
        return {ALL: list(range(len(rig.dofs)))}
    groups: dict[str, list[int]] = {name: [] for name in (TRUNK, HEAD, *(limb.name for limb in limbs))}
    for joint, bone in enumerate(rig.dof_bones.tolist()):
        above = _with_ancestors(rig, bone)
        near = [limb.name for limb in limbs if limb.ends[0] in above or bone in _with_ancestors(rig, limb.ends[0])]
        groups[near[0] if len(near) == 1 else TRUNK if near else HEAD].append(joint)
    return {name: joints for name, joints in groups.items() if joints}


def _with_ancestors(rig: Rig, bone: int) -> set[int]:
    found = set()
    while bone >= 0:
        found.add(bone)
        bone = int(np.asarray(rig.parents)[bone])
    return found
