"""Which joint of an avatar's skeleton is which bone of the rig: by name, by shape, by place, and by skin.

Skeletons of few joints let hands and feet go with forearm and shin. Garments need to know how long these are: joints
are added where the skin says that they end; nothing hangs on them. Dimensions: `V` vertices, `j` joints. Metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.skinned_mesh import SkinnedMesh
from physkin_core.file_reading import shown
from physkin_core.rig.bone_naming import limb_joints, missing_bones, named_bones, required_bones
from physkin_core.rig.bone_structure import (
    LIMB_BONES,
    bones_by_limbs,
    bones_by_structure,
    limb_ends,
    spine_by_place,
)
from physkin_core.rig.rig import Rig

__all__ = ["identify_bones"]

SHARE_OF_SKIN = {"arm": 0.58, "leg": 0.84}
"""Elbow to wrist over elbow to fingertips; knee to ankle over knee to sole."""
ROUNDS = 3


def identify_bones(mesh: SkinnedMesh, rig: Rig) -> tuple[SkinnedMesh, dict[str, int], str]:
    """The mesh, joint by rig bone, and the naming that led there (see `named_bones`).

    Where names fit no naming, those of limbs tell with the order of joints, or the skeleton's shape. Wrists and ankles
    that no name tells are the joints that follow on elbow or knee, or added where the skin ends. The mesh comes back
    with a warning of what was assumed.
    Raises RigError when none of it leads to all bones that are needed.
    """
    astray = [mesh.joint_names[joint] for joint in np.flatnonzero(~np.isfinite(mesh.joint_heads).all(axis=1))]
    if astray:
        raise AvatarError(f"avatar {mesh.source}: joints {', '.join(astray)} are not at finite positions")
    required = required_bones(rig)
    named, naming = named_bones(mesh.joint_names, rig, humanoid=mesh.humanoid)
    if 2 * sum(bone in named for bone in required) < len(required):
        skeleton = mesh.joint_heads, mesh.joint_parents, rig
        for found_by, shaped in (
            ("the limbs that they name", bones_by_limbs(limb_joints(mesh.joint_names), *skeleton)),
            ("the skeleton's shape", bones_by_structure(*skeleton)),
        ):
            if shaped is not None and all(bone in shaped for bone in required):
                warning = f"no naming fits the joints' names; by {found_by} these were taken: "
                return _with_taken(mesh, warning, {bone: shaped[bone] for bone in required}), shaped, found_by
    ends = limb_ends(named, mesh.joint_heads, mesh.joint_parents)
    longer, added = _with_limb_ends(mesh, named | ends)
    found = named | ends | added
    if any(bone not in found for bone in required):
        raise missing_bones(found, mesh.joint_names, rig, source=mesh.source)
    if ends:
        warning = "by their place at the ends of limbs, not by name, these joints were taken: "
        longer = _with_taken(longer, warning, ends)
    if added:
        warning = f"the skeleton has no joint for {', '.join(added)}: put where skin says that the limb ends"
        longer = _with_warning(longer, warning)
    return longer, spine_by_place(found, longer.joint_heads, rig), naming


def _with_taken(mesh: SkinnedMesh, warning: str, taken: Mapping[str, int]) -> SkinnedMesh:
    """The mesh with a warning that lists joints by rig bone."""
    pairs = ", ".join(f"{shown(mesh.joint_names[joint])} for {bone}" for bone, joint in taken.items())
    return _with_warning(mesh, warning + pairs)


def _with_warning(mesh: SkinnedMesh, warning: str) -> SkinnedMesh:
    return replace(mesh, warnings=(*mesh.warnings, warning))


def _with_limb_ends(mesh: SkinnedMesh, named: Mapping[str, int]) -> tuple[SkinnedMesh, dict[str, int]]:
    """The mesh with a joint for each wrist and ankle that is not among the named ones (joint by rig bone), where elbow
    or knee is known and skin hangs on it or what follows; and these joints by rig bone."""
    ends: dict[str, tuple[int, np.ndarray]] = {}
    for side, (kind, (_, middle, end, _)) in product("LR", LIMB_BONES.items()):
        joint = named.get(f"{middle}.{side}")
        if joint is None or f"{end}.{side}" in named:
            continue
        skin = mesh.vertices[_carried(mesh, joint)]
        if len(skin):
            ends[f"{end}.{side}"] = joint, _end(skin, mesh.joint_heads[joint], SHARE_OF_SKIN[kind])
    if not ends:
        return mesh, {}
    parents, heads = zip(*ends.values())
    added = replace(
        mesh,
        joint_names=(*mesh.joint_names, *(f"{bone} by skin" for bone in ends)),
        joint_parents=np.concatenate([mesh.joint_parents, parents]),
        joint_heads=np.concatenate([mesh.joint_heads, heads]),
        joint_tails=np.concatenate([mesh.joint_tails, np.full((len(heads), 3), np.nan)]),
    )
    return added, {bone: len(mesh.joint_names) + k for k, bone in enumerate(ends)}


def _carried(mesh: SkinnedMesh, joint: int) -> np.ndarray:
    """(V,) bool: vertices that hang mostly on a joint and those that follow it."""
    below = np.zeros(len(mesh.joint_names), dtype=bool)
    for each, parent in enumerate(mesh.joint_parents):
        below[each] = each == joint or (parent >= 0 and below[parent])
    return (mesh.influence_weights * below[mesh.influence_joints]).sum(axis=1) > 0.5


def _end(skin: np.ndarray, head: np.ndarray, share: float) -> np.ndarray:
    """Where a limb ends: that share of the way from its joint's head (3,) to the farthest of its skin (k, 3), along the
    middle of the skin up to there; a foot turns off."""
    away = skin - head
    along, reach = away.mean(axis=0), 0.0
    for _ in range(ROUNDS):
        along = along / np.linalg.norm(along)
        way = away @ along
        reach = share * way.max()
        if (near := way <= reach).any():  # rings of vertices may be at the far end alone
            along = away[near].mean(axis=0)
    return head + reach * along / np.linalg.norm(along)
