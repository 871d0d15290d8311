"""Avatars from glTF 2.0: GLB, glTF and VRM (0.x and 1.0) files, and FBX, which is read as glTF.

The mesh is taken as it was bound to its joints (`gltf_skeleton`), with the morph weights that the file shows;
`retargeting` then puts it into the canonical pose. A file without a skin is a plain mesh.

Dimensions: `V` vertices, `j` joints, `K` influences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.gltf_copies import coarse_copies
from physkin_core.avatar.gltf_skeleton import GltfSkeleton, find_skeleton, rigid_skeleton
from physkin_core.avatar.mesh_avatar import retarget_plain_mesh
from physkin_core.avatar.retargeting import retarget
from physkin_core.avatar.skinned_mesh import (
    SkinnedMesh,
    Surface,
    check_influence_count,
    clean_surface,
    unit_scale,
)
from physkin_core.file_reading import ContentError, listed, shown
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_joints import humanoid_nodes, nearest_above, with_nodes_above
from physkin_core.formats.gltf_scene import Drawn, drawn_primitives, in_scene, material_of
from physkin_core.mesh.gltf_look import seen_faces, shows_through
from physkin_core.rig.joint_names import read_name
from physkin_core.rig.linear_blend_skinning import joined_influences, linear_blend_skinning, strongest_influence
from physkin_core.rig.rig import Rig

__all__ = ["load_gltf"]

# Rows: X forward, Y left, Z up. glTF and VRM 1.0 are Y up and face +Z; VRM 0.x faces -Z.
TO_ROOT_FRAME = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
VRM0_TO_ROOT_FRAME = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
END_SUFFIX = "_end"
SLIGHT, FEW = 0.05, 0.01
"""Skinning weights down to less than this below 0 come of resampling and rounding; and the share of vertices by whose
weights no body is spoilt."""


def load_gltf(path: Path, rig: Rig, *, rig_file: str | Path | None = None, bones: str | Path | None = None) -> Avatar:
    """Read a GLB, glTF, VRM or FBX file. Raises AvatarError (see `physkin_core.load_avatar`) and ContentError."""
    file = GltfFile(path, lenient=True, clips=False)
    rigid = None if file.document.count("skins") or rig_file is not None else rigid_skeleton(file, rig)
    if not file.document.count("skins") and rigid is None:
        return retarget_plain_mesh(_plain_mesh(file), rig, path=path, rig_file=rig_file, bones=bones, up="Y")
    if rig_file is not None:
        raise ContentError(f"it has its own skeleton; a rig file ({shown(str(rig_file))}) is for plain meshes")
    return retarget(_skinned_mesh(file, rig, rigid), rig, bones=bones)


def _plain_mesh(file: GltfFile) -> Surface:
    """All meshes of a file without skins, in glTF's frame."""
    placed = [(drawn, in_scene(file, drawn.node, drawn.positions)) for drawn in drawn_primitives(file)]
    if not placed:
        raise ContentError("it has no faces; a triangle mesh is needed")
    return _joined(file, *zip(*placed))


def _joined(file: GltfFile, drawn: Sequence[Drawn], positions: Sequence[np.ndarray]) -> Surface:
    """Primitives at positions (V, 3) as one surface, each a part of it."""
    starts = np.cumsum([0, *map(len, positions)])
    return Surface(
        vertices=np.concatenate(positions),
        faces=np.concatenate([each.faces + start for each, start in zip(drawn, starts)]),
        part_names=tuple(_part_names(file, each) for each in drawn),
        face_parts=np.repeat(np.arange(len(drawn)), [len(each.faces) for each in drawn]),
        clear_parts=frozenset(part for part, each in enumerate(drawn) if shows_through(file, each)),
        seen=np.concatenate([seen_faces(file, each) for each in drawn]),
    )


def _skinned_mesh(file: GltfFile, rig: Rig, rigid: GltfSkeleton | None) -> SkinnedMesh:
    humanoid = humanoid_nodes(file)
    skinned = [(drawn, file.nodes[drawn.node].index("skin")) for drawn in drawn_primitives(file)]
    counts = dict.fromkeys(range(file.document.count("skins")), 0)
    for drawn, skin in skinned:
        if skin is not None:
            file.document.item("skins", skin)
            counts[skin] += len(drawn.positions)
    skeleton = rigid or find_skeleton(file, counts, rig, humanoid)
    warnings = [*_mended(file, humanoid or {}), *skeleton.warnings]
    names = [node.text("name") or "" for node in file.nodes]
    coarse = coarse_copies([drawn for drawn, skin in skinned if skin in skeleton.skins], names)
    if coarse:
        called = listed([file.nodes[node].text("name") or f"node {node}" for node in sorted(coarse)])
        warnings.append(f"these meshes draw again what others draw finer: {called}; left out")
    bound, rigid, carriers = [], [], nearest_above(file, skeleton.joint)
    for drawn, skin in skinned:
        if drawn.node in coarse or skin not in (None, *skeleton.skins):
            continue
        label = shown(file.nodes[drawn.node].text("name") or f"node {drawn.node}")
        if skin is None:
            carrier = carriers.get(drawn.node)
            if carrier is None:
                warnings.append(f"mesh {label} has no skin and hangs on no joint: left out")
                continue
            world = skeleton.worlds[drawn.node]
            bound.append(_Bound(drawn, drawn.positions @ world[:3, :3].T + world[:3, 3], *_on(drawn, carrier)))
            continue
        transforms = skeleton.skins[skin].transforms(file, skeleton.worlds)
        if "JOINTS_0" not in drawn.primitive.entry("attributes"):
            rigid.append((drawn, transforms, label))
            continue
        joints, weights, said = _skin_influences(file, drawn, len(skeleton.skins[skin].joints), label)
        warnings += said
        placed = linear_blend_skinning(drawn.positions, transforms, joints, weights)
        own = np.array([skeleton.joint[joint] for joint in skeleton.skins[skin].joints])
        bound.append(_Bound(drawn, placed, own[joints], weights))
    for drawn, transforms, label in rigid:
        part = f"{drawn.primitive.where} of mesh {label}"
        if not bound:
            raise ContentError(f"{part} has a skin but no JOINTS_0 and WEIGHTS_0")
        bound.append(_lying_at(drawn, transforms[0], bound))
        name = file.nodes[skeleton.nodes[bound[-1].joints[0, 0]]].text("name")
        warnings.append(f"{part} has no skinning weights: it moves with joint {shown(name)}, at which it lies")
    if not bound:
        raise ContentError("it has no faces on its skeleton; a triangle mesh is needed")
    drawn, positions, *influences = zip(*bound)
    attributes = tuple(map(joined_influences, influences))
    surface, (joints, weights), kept = clean_surface(_joined(file, drawn, positions), attributes, str(file.path))
    nodes, worlds = skeleton.nodes, skeleton.worlds[skeleton.nodes]
    place = {node: k for k, node in enumerate(nodes)}
    held = (file.node_worlds[nodes] @ np.linalg.pinv(np.nan_to_num(worlds)))[:, :3]
    scale, unit_warning = unit_scale(surface.vertices)
    frame = np.eye(4)
    frame[:3, :3] = scale * _frame(file)
    return SkinnedMesh(
        vertices=surface.vertices @ frame[:3, :3].T,
        faces=surface.faces,
        joint_names=tuple(file.nodes[node].text("name") or f"node {node}" for node in nodes),
        joint_parents=np.array([place.get(int(file.node_parents[node]), -1) for node in nodes]),
        joint_heads=worlds[:, :3, 3] @ frame[:3, :3].T,
        joint_tails=_joint_tails(file, skeleton) @ frame[:3, :3].T,
        influence_joints=joints,
        influence_weights=weights,
        source=str(file.path),
        humanoid=None if humanoid is None else {name: place[node] for name, node in humanoid.items()},
        warnings=(*dict.fromkeys(warnings), *unit_warning),
        part_names=surface.part_names,
        face_parts=surface.face_parts,
        clear_parts=surface.clear_parts,
        seen=surface.seen,
        file_vertices=linear_blend_skinning(surface.vertices, held, joints, weights),
        file_corners=np.concatenate([each.corners for each in drawn])[kept],
        joint_nodes=np.array(nodes),
        joint_frames=frame @ worlds,
    )


class _Bound(NamedTuple):
    """A primitive in the pose that the body is taken in. positions: (V, 3), scene. joints, weights: (V, K)."""

    drawn: Drawn
    positions: np.ndarray
    joints: np.ndarray
    weights: np.ndarray


def _on(drawn: Drawn, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Influences (V, 1) of one joint, and their weights."""
    count = len(drawn.positions)
    return np.full((count, 1), joint), np.ones((count, 1))


def _lying_at(drawn: Drawn, transform: np.ndarray, bound: Sequence[_Bound]) -> _Bound:
    """A primitive without skinning weights on the joint that most skin next to it hangs on. transform: (3, 4)."""
    from scipy.spatial import cKDTree

    placed = drawn.positions @ transform[:, :3].T + transform[:, 3]
    strongest = [strongest_influence(each.joints, each.weights) for each in bound]
    near = np.concatenate(strongest)[cKDTree(np.concatenate([each.positions for each in bound])).query(placed)[1]]
    return _Bound(drawn, placed, *_on(drawn, int(np.bincount(near).argmax())))


def _mended(file: GltfFile, humanoid: Mapping[str, int]) -> list[str]:
    """What was wrong with nodes that decide nothing, a warning each. Raises ContentError where one is, or bears, a bone
    that has a name."""
    telling = (k for k, node in enumerate(file.nodes) if k in humanoid.values() or read_name(node.text("name")).bones)
    deciding = set(with_nodes_above(file, telling))
    for node, fault in file.mended.items():
        if node in deciding and "turns by nothing" not in fault:
            raise ContentError(fault)
    return [f"{shown(file.nodes[node].text('name'))}: {fault}; taken as none" for node, fault in file.mended.items()]


def _part_names(file: GltfFile, drawn: Drawn) -> tuple[str, ...]:
    """Names of a primitive's material, mesh and node, those that there are."""
    material = material_of(file, drawn.primitive)
    named = ("" if material is None else material.text("name"), drawn.mesh.text("name"))
    return tuple(filter(None, (*named, file.nodes[drawn.node].text("name")))) or (f"node {drawn.node}",)


def _skin_influences(file: GltfFile, drawn: Drawn, limit: int, label: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Indices into the skin's joints (V, K), below `limit`, weights (V, K) with rows summing to 1, and what was mended.
    Those of vertices that no face uses do not matter."""
    joints, weights, count = [], [], len(drawn.positions)
    while (named := file.attribute(drawn.primitive, f"JOINTS_{len(joints)}")) is not None:
        joints.append(named)
        found = file.attribute(drawn.primitive, f"WEIGHTS_{len(weights)}")
        weights.append(np.empty((0, 0)) if found is None else found.astype(np.float64))
        check_influence_count(sum(each.shape[1] for each in joints))
    if any(one.shape != other.shape or len(one) != count for one, other in zip(joints, weights)):
        shapes = ", ".join(f"{one.shape} and {other.shape}" for one, other in zip(joints, weights))
        raise ContentError(f"mesh {label} has {count} vertices, joints and weights {shapes}; these must agree")
    joint, weight, said = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1), []
    unused = np.ones(count, dtype=bool)
    unused[drawn.faces] = False
    weight[unused] = 0
    odd = ~np.isfinite(weight)
    weight[odd] = 0
    if odd.any(axis=1).mean() > FEW or weight.min() < -SLIGHT:
        raise ContentError(f"skinning weights of mesh {label} must be finite and not negative")
    mended = np.flatnonzero((odd | (weight < 0)).any(axis=1) & ~unused)
    if len(mended):
        what = f"{len(mended)} vertices of {label} have skinning weights that are below 0 or not finite"
        said.append(f"{what}, the first is {mended[0]}: taken as 0")
    weight = np.maximum(weight, 0)
    joint = np.where(weight > 0, joint, 0)
    if joint.dtype.kind != "i" or joint.min() < 0 or joint.max() >= limit:
        raise ContentError(f"mesh {label} names joint {joint.max()}, allowed 0 to {limit - 1}")
    total = weight.sum(axis=1)
    weight[total <= 0, 0] = 1.0
    if unbound := int(((total <= 0) & ~unused).sum()):
        said.append(f"{unbound} vertices of {label} have no skinning weights: bound to the first joint")
    return joint, weight / weight.sum(axis=1, keepdims=True), said


def _joint_tails(file: GltfFile, skeleton: GltfSkeleton) -> np.ndarray:
    """(j, 3) place of a joint's child node named `JOINT_end` (as modelling tools export leaf bones), else NaN."""
    tails = np.full((len(skeleton.nodes), 3), np.nan)
    for joint, node in enumerate(skeleton.nodes):
        end = f"{file.nodes[node].text('name')}{END_SUFFIX}"
        for child in file.node_children[node]:
            if file.nodes[child].text("name") == end:
                tails[joint] = skeleton.worlds[child][:3, 3]
    return tails


def _frame(file: GltfFile) -> np.ndarray:
    """(3, 3) from the file's frame to the root frame."""
    extensions = file.document.entry("extensions")
    return VRM0_TO_ROOT_FRAME if "VRM" in extensions and "VRMC_vrm" not in extensions else TO_ROOT_FRAME
