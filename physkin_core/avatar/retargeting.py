"""Put a skinned mesh into the canonical pose through its own skeleton and bind it to the garment model's rig.

Loaders (`gltf_avatar`, `mesh_avatar`) fill a `SkinnedMesh` (`skinned_mesh`); `retarget` makes the `Avatar`.

Dimensions: `V` vertices, `f` faces, `j` joints of the avatar's skeleton, `b` bones of the rig, `K` influences. Metres.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from physkin_core.avatar.appendages import with_appendages_apart
from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.body_parts import bare_parts, split_body
from physkin_core.avatar.joint_identification import identify_bones
from physkin_core.avatar.skin_beneath import with_skin_beneath
from physkin_core.avatar.skinned_mesh import SkinnedMesh, check_size, turn_upright, with_joints_moved
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS, limb_rotations, smallest_rotation, turned_down_the_chain
from physkin_core.rig.human_skeleton import spine_bones
from physkin_core.rig.linear_blend_skinning import dense_weights, linear_blend_skinning, strongest_influences
from physkin_core.rig.rig import Rig

__all__ = ["covered_bones", "place_bones", "retarget"]

MAX_INFLUENCES = 8
JOINT_DEVIATIONS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
"""[m] how far a joint may lie from where the compact body model has it on the same person."""
LIKELY_COEFFICIENT = 3.0


def retarget(mesh: SkinnedMesh, rig: Rig, *, bones: str | Path | None = None) -> Avatar:
    """Canonical pose, root at the origin, bones and influences of `rig`. bones: as of `load_avatar`.

    Raises AvatarError when required joints are missing, a limb has no length or the height is implausible.
    """
    mesh, skeleton = identify_bones(mesh, rig, bones)
    bone_joint = skeleton.joints
    mesh = turn_upright(mesh, bone_joint, rig)
    mesh = _canonical(mesh, bone_joint, rig)
    check_size(mesh.vertices, mesh.source)
    scale = _leg_ratio({bone: mesh.joint_heads[joint] for bone, joint in bone_joint.items()}, rig, rig.heads)
    joint_bones = _joint_bones(mesh, bone_joint, rig)
    root_joint = bone_joint.get(rig.bone_names[0]) if skeleton.own_names else None
    heads, tails, root = place_bones(mesh, bone_joint, rig, root_joint=root_joint)
    placed = {"heads": heads, "tails": tails, "scale": scale}
    mesh = with_appendages_apart(mesh, bone_joint, joint_bones, rig, **placed)
    whole, parts = mesh, split_body(mesh, joint_bones, rig, scale=scale)
    mesh = parts.body
    of_file = _file_joints(mesh, bone_joint, rig, root)
    closed = whole if parts.clothes else mesh  # skin may be hands and face alone
    outward = slice(None, None, _orientation(closed.vertices, closed.faces))

    def bound(part: SkinnedMesh) -> Avatar:
        bones, weights = _rig_influences(part, joint_bones, bone_joint, rig, heads, tails)
        return Avatar(
            vertices=(part.vertices - root).astype(np.float32),
            faces=part.faces[:, outward].astype(np.int32),
            bone_heads=(heads - root).astype(np.float32),
            bone_tails=(tails - root).astype(np.float32),
            influence_bones=bones,
            influence_weights=weights,
            source=part.source,
            warnings=part.warnings,
            bone_names=rig.bone_names,
            file_vertices=part.file_vertices,
            file_corners=None if part.file_corners is None else part.file_corners[:, outward],
            **of_file,
        )

    clothes = tuple(map(bound, parts.clothes))
    skin = with_skin_beneath(bound(mesh), clothes)
    bare = bare_parts(skin, rig)
    said = (f"the body has no skin on {', '.join(bare)}: clothes there have nothing to lie on",) if bare else ()
    return replace(
        skin,
        warnings=(*skin.warnings, *said),
        accessories=None if parts.accessories is None else bound(parts.accessories),
        clothes=clothes,
    )


def place_bones(
    mesh: SkinnedMesh, bone_joint: Mapping[str, int], rig: Rig, *, root_joint: int | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heads and tails (b, 3) of all rig bones on the avatar as it is posed, and the root's place (3,).

    Mapped bones take their joint. Others are placed between their nearest mapped neighbours as in the reference
    skeleton, turned and scaled with the stretch between these. Without a `root_joint` the root is placed from the hips.
    """
    known = {bone: mesh.joint_heads[joint] for bone, joint in bone_joint.items()}
    reference_heads, reference_tails = _reference_bones(rig, known)
    scale = _leg_ratio(known, rig, reference_heads)
    root = rig.bone_names[0]
    if root_joint is None:
        hips = [f"upperleg01.{side}" for side in "LR"]
        offset = np.mean([reference_heads[rig.bone_index(name)] for name in hips], axis=0) - reference_heads[0]
        known[root] = np.mean([known[name] for name in hips], axis=0) - scale * offset
    heads = np.empty((rig.bone_count, 3))
    for bone, name in enumerate(rig.bone_names):
        heads[bone] = known[name] if name in known else _between(bone, rig, heads, known, reference_heads, scale)
    tails = heads + scale * (reference_tails - reference_heads)
    for bone, name in enumerate(rig.bone_names):
        follower = _follower(rig, bone)
        given = mesh.joint_tails[bone_joint[name]] if name in bone_joint else np.full(3, np.nan)
        if follower is not None:
            tails[bone] = heads[follower]
        elif np.isfinite(given).all():
            tails[bone] = given
    return heads, tails, heads[0].copy()


def _reference_bones(rig: Rig, known: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Heads and tails (b, 3) of a likely body with this skeleton; on a rig of its own kind, that rig's bones.

    The compact body model's shape that explains the known joints (3,) best, place being free. Each joint is trusted to
    the first of `JOINT_DEVIATIONS` that leaves a likely shape, so an unusual skeleton gets an average body.
    """
    body = load_body_model()
    if rig.bone_names != body.rig.bone_names:
        return rig.heads, rig.tails
    known_bones = [rig.bone_index(name) for name in known]
    mean, components = body.mean_bones[known_bones, 0], body.bone_components[:, known_bones, 0]
    gap = np.stack([known[name] for name in known]) - mean
    gap, components = gap - gap.mean(axis=0), components - components.mean(axis=1, keepdims=True)
    design = components.reshape(len(components), -1).astype(np.float64)
    for deviation in JOINT_DEVIATIONS:
        system = design @ design.T + deviation**2 * np.eye(len(design))
        coefficients = np.linalg.solve(system, design @ gap.reshape(-1))
        if np.abs(coefficients).max() < LIKELY_COEFFICIENT:
            break
    heads, tails = body.bones(coefficients)
    return heads.astype(np.float64), tails.astype(np.float64)


def _leg_ratio(known: Mapping[str, np.ndarray], rig: Rig, reference: np.ndarray) -> float:
    """Leg length of the avatar over that of the reference skeleton; of the whole skeleton on a rig without legs."""
    legs = [segment for bone, segment in LIMB_SEGMENTS.items() if "leg" in bone]
    if any(name not in known for leg in legs for name in leg):
        legs = [(rig.bone_names[0], name) for name in known]
    model_heads = dict(zip(rig.bone_names, reference))
    own, model = (sum(np.linalg.norm(at[end] - at[start]) for start, end in legs) for at in (known, model_heads))
    return float(own / model) if own > 1e-9 and model > 1e-9 else 1.0


def _between(bone: int, rig: Rig, heads: np.ndarray, known: Mapping, reference: np.ndarray, scale: float) -> np.ndarray:
    above = next(each for each in rig.ancestors(bone)[1:] if rig.bone_names[each] in known)
    below = _nearest_known_below(bone, rig, known)
    offset = reference[bone] - reference[above]
    if below:
        model = reference[below].mean(axis=0) - reference[above]
        own = np.mean([known[rig.bone_names[index]] for index in below], axis=0) - heads[above]
        lengths = np.linalg.norm(model), np.linalg.norm(own)
        if min(lengths) > 1e-6:
            return heads[above] + lengths[1] / lengths[0] * (smallest_rotation(model, own) @ offset)
    return heads[above] + scale * offset


def _nearest_known_below(bone: int, rig: Rig, known: Mapping) -> list[int]:
    found = []
    for child in np.flatnonzero(rig.parents == bone):
        found += [int(child)] if rig.bone_names[child] in known else _nearest_known_below(int(child), rig, known)
    return found


def _follower(rig: Rig, bone: int) -> int | None:
    """The bone whose head is this bone's tail, if there is one."""
    at_tail = np.flatnonzero(np.linalg.norm(rig.heads - rig.tails[bone], axis=1) < 1e-4)
    return int(at_tail[0]) if len(at_tail) else None


def _canonical(mesh: SkinnedMesh, bone_joint: Mapping[str, int], rig: Rig) -> SkinnedMesh:
    """Turn the limbs into the rig's directions by linear blend skinning on the avatar's own joints."""
    heads = {bone: mesh.joint_heads[joint] for bone, joint in bone_joint.items()}
    try:
        turns = limb_rotations(heads, dict(zip(rig.bone_names, rig.heads)))
    except ValueError as error:
        raise AvatarError(f"avatar {mesh.source}: {error}") from error
    joint_turn = {joint: turns[bone] for bone, joint in bone_joint.items() if bone in turns}
    transforms, _ = turned_down_the_chain(mesh.joint_heads, mesh.joint_parents, joint_turn)
    vertices = linear_blend_skinning(mesh.vertices, transforms, mesh.influence_joints, mesh.influence_weights)
    return with_joints_moved(replace(mesh, vertices=vertices), transforms)


def _file_joints(mesh: SkinnedMesh, bone_joint: Mapping[str, int], rig: Rig, root: np.ndarray) -> dict:
    """What `Avatar` keeps of the file's joints; nothing where the file has none."""
    if mesh.joint_nodes is None:
        return {}
    nodes, frames = np.full(rig.bone_count, -1), np.full((rig.bone_count, 4, 4), np.nan)
    for bone, joint in bone_joint.items():
        if mesh.joint_nodes[joint] >= 0:
            index = rig.bone_index(bone)
            nodes[index], frames[index] = mesh.joint_nodes[joint], mesh.joint_frames[joint]
    frames[:, :3, 3] -= root
    return {"file_joints": nodes, "file_joint_frames": frames}


def _joint_bones(mesh: SkinnedMesh, bone_joint: Mapping[str, int], rig: Rig) -> np.ndarray:
    """(j,) rig bone of each joint: its own, or its nearest mapped ancestor's."""
    joint_bone = {joint: rig.bone_index(bone) for bone, joint in bone_joint.items()}
    target = np.zeros(len(mesh.joint_names), dtype=np.int64)
    for joint, parent in enumerate(mesh.joint_parents):
        target[joint] = joint_bone.get(joint, target[parent] if parent >= 0 else 0)
    return target


def _rig_influences(
    mesh: SkinnedMesh,
    joint_bones: np.ndarray,
    bone_joint: Mapping[str, int],
    rig: Rig,
    heads: np.ndarray,
    tails: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Influences over rig bones, each joint's on its bone of `joint_bones` (j,)."""
    dense = dense_weights(joint_bones[mesh.influence_joints], mesh.influence_weights, rig.bone_count)
    for bone in {0, *map(rig.bone_index, bone_joint)}:
        _spread_along_chain(dense, bone, rig, bone_joint, mesh.vertices, heads, tails)
    bones, weights = strongest_influences(dense, min(MAX_INFLUENCES, max(1, int((dense > 0).sum(axis=1).max()))))
    return bones.astype(np.int32), weights.astype(np.float32)


def _spread_along_chain(dense, bone, rig, bone_joint, vertices, heads, tails) -> None:
    """Share one joint's influence among the rig bones it covers, so that twist is spread (see `covered_bones`).

    A vertex's share goes over linearly from the middle of one bone to the middle of the next along the chain.
    """
    chain = covered_bones(bone, rig, bone_joint)
    direction = tails[chain[-1]] - heads[bone]
    length = np.linalg.norm(direction)
    if len(chain) == 1 or length < 1e-6:
        return
    rows = np.flatnonzero(dense[:, bone])
    along = (vertices[rows] - heads[bone]) @ direction / length
    middles = ((heads[chain] + tails[chain]) / 2 - heads[bone]) @ direction / length
    shares = np.stack([np.interp(along, middles, unit) for unit in np.eye(len(chain))], axis=1)
    dense[rows[:, None], chain] = dense[rows, bone, None] * shares


def covered_bones(bone: int, rig: Rig, bone_joint: Collection[str]) -> list[int]:
    """A joint's bone and those after it without a joint: upperarm01 and upperarm02; of the root of a skeleton without
    a spine, that, as cloth bends with it."""
    if bone == 0:
        spine = spine_bones(rig)
        return [0, *map(rig.bone_index, spine)] if set(spine).isdisjoint(bone_joint) else [0]
    chain = [bone]
    while len(children := np.flatnonzero(rig.parents == chain[-1])) == 1:
        if rig.bone_names[children[0]] in bone_joint:
            break
        chain.append(int(children[0]))
    return chain


def _orientation(vertices: np.ndarray, faces: np.ndarray) -> int:
    """1, or -1 where the enclosed volume is negative (mirrored transforms, inside-out meshes)."""
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    return 1 if np.einsum("fi,fi->", a, np.cross(b, c)) >= 0 else -1
