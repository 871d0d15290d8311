"""Which joint of an avatar's skeleton is which bone of the rig, with joints added where limbs end without one.

Skeletons of few joints let hands and feet go with forearm and shin. Garments need to know how long these are: joints
are added where the skin says that they end; nothing hangs on them. Dimensions: `V` vertices, `j` joints. Metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.skinned_mesh import SkinnedMesh
from physkin_core.rig.bones_file import read_bones_file
from physkin_core.rig.human_skeleton import LIMB_BONES, HumanSkeleton, find_human_skeleton
from physkin_core.rig.rig import Rig, RigError

__all__ = ["identify_bones"]

SHARE_OF_SKIN = {"arm": 0.58, "leg": 0.84}
"""Elbow to wrist over elbow to fingertips; knee to ankle over knee to sole."""
ROUNDS = 3
TOES, BACKWARDS = 0.05, 0.15
"""Shares of a shin by which the skin of feet must lie before the ankles, or behind them, to tell left from right, and
behind them to say otherwise than names."""


def identify_bones(mesh: SkinnedMesh, rig: Rig, bones: str | Path | None = None) -> tuple[SkinnedMesh, HumanSkeleton]:
    """The mesh, with wrists and ankles added where the skeleton has none, and which joint is which bone of the rig. The
    mesh comes back with a warning of what was assumed. bones: the bones file; None: that beside the mesh's file.

    Raises RigError when a bone that is needed has no joint.
    """
    astray = [mesh.joint_names[joint] for joint in np.flatnonzero(~np.isfinite(mesh.joint_heads).all(axis=1))]
    if astray:
        raise AvatarError(f"avatar {mesh.source}: joints {', '.join(astray)} are not at finite positions")
    by_hand = read_bones_file(bones, Path(mesh.source), rig.bone_names, mesh.joint_names)
    said = {"humanoid": mesh.humanoid, "by_hand": by_hand}
    skeleton = find_human_skeleton(mesh.joint_names, mesh.joint_parents, mesh.joint_heads, rig, **said)
    if not skeleton.missing and not by_hand and "upperleg01.L" in skeleton.joints:  # of a person's rig
        left = _left_by_feet(mesh, skeleton.joints)
        if left < -(BACKWARDS if skeleton.sides_told else TOES):
            said = "by its feet it faces the other way than by its names: left and right are exchanged"
            skeleton = replace(skeleton.mirrored(), doubt=said if skeleton.sides_told else "")
        elif left > TOES:
            skeleton = replace(skeleton, doubt="")
    longer, added = _with_limb_ends(mesh, skeleton.joints)
    missing = tuple(bone for bone in skeleton.missing if bone not in added)
    if missing:
        refused = replace(skeleton, missing=missing).refusal(mesh.joint_names, rig)
        raise RigError(f"avatar {mesh.source}: {refused}")
    remarks = skeleton.remarks(mesh.joint_names)
    if added:
        remarks += (f"the skeleton has no joint for {', '.join(added)}: put where skin says that the limb ends",)
    longer = replace(longer, warnings=(*mesh.warnings, *remarks))
    return longer, replace(skeleton, joints=skeleton.joints | added, missing=())


def _left_by_feet(mesh: SkinnedMesh, joints: Mapping[str, int]) -> float:
    """How far, in lengths of a shin, feet's skin lies before the ankles if the joints' left is left; below 0 behind
    them. joints: by rig bone."""
    heads = {bone: mesh.joint_heads[joint] for bone, joint in joints.items()}
    bones = "upperleg01", "lowerleg01", "foot"
    hips, knees, ankles = ([heads[f"{bone}.{side}"] for side in "LR"] for bone in bones)
    shin = np.linalg.norm(ankles[0] - knees[0])
    forward = np.cross(hips[0] - hips[1], knees[0] + knees[1] - ankles[0] - ankles[1])
    skins = [mesh.vertices[_carried(mesh, joints[f"foot.{side}"])] for side in "LR"]
    toes = sum((skin.mean(axis=0) - ankle for skin, ankle in zip(skins, ankles) if len(skin)), np.zeros(3))
    return float(toes @ forward / max(2 * shin * np.linalg.norm(forward), 1e-12))


def _with_limb_ends(mesh: SkinnedMesh, named: Mapping[str, int]) -> tuple[SkinnedMesh, dict[str, int]]:
    """The mesh with a joint for each wrist and ankle that is not among the named ones (joint by rig bone), where elbow
    or knee is known and skin hangs on it or what follows; and these joints by rig bone."""
    ends: dict[str, tuple[int, np.ndarray]] = {}
    for side, (kind, (_, middle, end)) in product("LR", LIMB_BONES.items()):
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
        joint_nodes=None if mesh.joint_nodes is None else np.append(mesh.joint_nodes, [-1] * len(heads)),
        joint_frames=None
        if mesh.joint_frames is None
        else mesh.joint_frames[[*range(len(mesh.joint_heads)), *parents]],
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
