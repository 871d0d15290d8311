"""Avatars from glTF 2.0: GLB, glTF and VRM (0.x and 1.0) files, and FBX, which is read as glTF.

The mesh is taken as the file shows it (node transforms, default morph weights, skinning), with its own joint hierarchy;
`retargeting` then puts it into the canonical pose. A file without a skin is a plain mesh.

Dimensions: `V` vertices, `j` joints (see `_joints`), `g` nodes, `K` influences.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.mesh_avatar import retarget_plain_mesh
from physkin_core.avatar.retargeting import retarget
from physkin_core.avatar.skinned_mesh import (
    SkinnedMesh,
    Surface,
    check_bone_count,
    check_influence_count,
    clean_surface,
    unit_scale,
)
from physkin_core.file_reading import ContentError, shown
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_joints import humanoid_nodes
from physkin_core.formats.gltf_scene import Drawn, drawn_primitives, in_scene, material_of
from physkin_core.mesh.gltf_look import seen_faces, shows_through
from physkin_core.rig.linear_blend_skinning import joined_influences, linear_blend_skinning
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["load_gltf"]

# Rows: X forward, Y left, Z up. glTF and VRM 1.0 are Y up and face +Z; VRM 0.x faces -Z.
TO_ROOT_FRAME = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
VRM0_TO_ROOT_FRAME = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
END_SUFFIX = "_end"


def load_gltf(path: Path, rig: Rig, *, rig_file: str | Path | None = None, bones: str | Path | None = None) -> Avatar:
    """Read a GLB, glTF, VRM or FBX file. Raises AvatarError (see `physkin_core.load_avatar`) and ContentError."""
    file = GltfFile(path, clips=False)
    if not file.document.count("skins"):
        return retarget_plain_mesh(_plain_mesh(file), rig, path=path, rig_file=rig_file, bones=bones, up="Y")
    if rig_file is not None:
        raise ContentError(f"it has its own skeleton; a rig file ({shown(str(rig_file))}) is for plain meshes")
    return retarget(_skinned_mesh(file), rig, bones=bones)


def _plain_mesh(file: GltfFile) -> Surface:
    """All meshes of a file without skins, in glTF's frame."""
    parts, start = [], 0
    for drawn in drawn_primitives(file):
        placed = in_scene(file, drawn.node, drawn.positions)
        looks = _part_names(file, drawn), shows_through(file, drawn), seen_faces(file, drawn)
        parts.append((placed, drawn.faces + start, *looks))
        start += len(placed)
    if not parts:
        raise ContentError("it has no faces; a triangle mesh is needed")
    vertices, faces, names, clear, seen = zip(*parts)
    face_parts = np.repeat(np.arange(len(parts)), list(map(len, faces)))
    clear_parts = frozenset(np.flatnonzero(clear).tolist())
    vertices, faces, seen = map(np.concatenate, (vertices, faces, seen))
    return Surface(vertices, faces, names, face_parts, clear_parts, seen)


def _skinned_mesh(file: GltfFile) -> SkinnedMesh:
    humanoid = humanoid_nodes(file)
    joint_nodes, node_joint = _joints(file, humanoid or {})
    warnings, parts, start = [], [], 0
    for drawn in drawn_primitives(file):
        node, positions = drawn.node, drawn.positions
        label = shown(file.nodes[node].text("name") or f"node {node}")
        skin = file.nodes[node].index("skin")
        if skin is not None:
            joints, weights, unbound = _skin_influences(file, drawn, skin, label)
            if unbound:
                warnings.append(f"{unbound} vertices of {label} have no skinning weights: bound to the first joint")
            positions = linear_blend_skinning(positions, _skin_transforms(file, skin), joints, weights)
            joints = np.array([node_joint[joint] for joint in _skin_joints(file, skin)])[joints]
        else:
            carrier = next(
                (node_joint[each] for each in ancestors(file.node_parents, node) if each in node_joint), None
            )
            if carrier is None:
                warnings.append(f"mesh {label} has no skin and hangs on no joint: left out")
                continue
            positions = in_scene(file, node, positions)
            joints, weights = np.full((len(positions), 1), carrier), np.ones((len(positions), 1))
        looks = _part_names(file, drawn), shows_through(file, drawn), seen_faces(file, drawn)
        parts.append((positions, drawn.faces + start, joints, weights, drawn.corners, *looks))
        start += len(positions)
    if not parts:
        raise ContentError("it has no faces on its skeleton; a triangle mesh is needed")
    vertices, faces, joints, weights, corners, names, clear, seen = zip(*parts)
    face_parts = np.repeat(np.arange(len(parts)), list(map(len, faces)))
    vertices, faces, corners, seen = map(np.concatenate, (vertices, faces, corners, seen))
    influences = joined_influences(joints), joined_influences(weights)
    vertices, faces, (joints, weights), kept = clean_surface(vertices, faces, influences, str(file.path))
    heads = file.node_worlds[joint_nodes][:, :3, 3]
    scale, unit_warning = unit_scale(vertices)
    frame = scale * _frame(file)
    return SkinnedMesh(
        vertices=vertices @ frame.T,
        faces=faces,
        joint_names=tuple(file.nodes[node].text("name") or f"node {node}" for node in joint_nodes),
        joint_parents=np.array([node_joint.get(int(file.node_parents[node]), -1) for node in joint_nodes]),
        joint_heads=heads @ frame.T,
        joint_tails=_joint_tails(file, joint_nodes) @ frame.T,
        influence_joints=joints,
        influence_weights=weights,
        source=str(file.path),
        humanoid=None if humanoid is None else {name: node_joint[node] for name, node in humanoid.items()},
        warnings=(*dict.fromkeys(warnings), *unit_warning),
        part_names=names,
        face_parts=face_parts[kept],
        clear_parts=frozenset(np.flatnonzero(clear).tolist()),
        seen=seen[kept],
        file_vertices=vertices,
        file_corners=corners[kept],
    )


def _part_names(file: GltfFile, drawn: Drawn) -> tuple[str, ...]:
    """Names of a primitive's material, mesh and node, those that there are."""
    material = material_of(file, drawn.primitive)
    named = ("" if material is None else material.text("name"), drawn.mesh.text("name"))
    return tuple(filter(None, (*named, file.nodes[drawn.node].text("name")))) or (f"node {drawn.node}",)


def _joints(file: GltfFile, humanoid: dict[str, int]) -> tuple[list[int], dict[int, int]]:
    """Nodes of the skeleton, parents first, and the joint index of each.

    These are all skins' joints, the VRM humanoid bones (a skin need not use them all), and their ancestors.
    """
    nodes: set[int] = set()
    skinned = (joint for skin in file.document.entries("skins") for joint in _named(file, skin))
    for joint in (*humanoid.values(), *skinned):
        while joint >= 0 and joint not in nodes:
            nodes.add(joint)
            joint = int(file.node_parents[joint])
    check_bone_count(len(nodes))
    joint_nodes = [node for node in file.node_order if node in nodes]
    return joint_nodes, {node: joint for joint, node in enumerate(joint_nodes)}


def _skin_joints(file: GltfFile, skin: int) -> list[int]:
    return _named(file, file.document.item("skins", skin))


def _named(file: GltfFile, skin: GltfEntry) -> list[int]:
    """Nodes that are the joints of a skin."""
    nodes = skin.indices("joints")
    if not nodes or max(nodes) >= len(file.nodes):
        raise ContentError(f"joints of {skin.where} are {shown(nodes)}, allowed are nodes 0 to {len(file.nodes) - 1}")
    return nodes


def _skin_influences(file: GltfFile, drawn: Drawn, skin: int, label: str) -> tuple[np.ndarray, np.ndarray, int]:
    """Indices into the skin's joints (V, K), weights (V, K) with rows summing to 1, and how many vertices had none."""
    joints, weights, count = [], [], len(drawn.positions)
    while (named := file.attribute(drawn.primitive, f"JOINTS_{len(joints)}")) is not None:
        joints.append(named)
        found = file.attribute(drawn.primitive, f"WEIGHTS_{len(weights)}")
        weights.append(np.empty((0, 0)) if found is None else found.astype(np.float64))
        check_influence_count(sum(each.shape[1] for each in joints))
    if not joints:
        raise ContentError(f"mesh {label} has a skin but no JOINTS_0 and WEIGHTS_0")
    if any(one.shape != other.shape or len(one) != count for one, other in zip(joints, weights)):
        shapes = ", ".join(f"{one.shape} and {other.shape}" for one, other in zip(joints, weights))
        raise ContentError(f"mesh {label} has {count} vertices, joints and weights {shapes}; these must agree")
    joint, weight = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
    if not np.isfinite(weight).all() or weight.min() < 0:
        raise ContentError(f"skinning weights of mesh {label} must be finite and not negative")
    limit = len(_skin_joints(file, skin))
    joint = np.where(weight > 0, joint, 0)
    if joint.dtype.kind != "i" or joint.min() < 0 or joint.max() >= limit:
        raise ContentError(f"mesh {label} names joint {joint.max()}, allowed 0 to {limit - 1}")
    total = weight.sum(axis=1)
    weight[total <= 0, 0] = 1.0
    return joint, weight / weight.sum(axis=1, keepdims=True), int((total <= 0).sum())


def _skin_transforms(file: GltfFile, skin: int) -> np.ndarray:
    """(joints, 3, 4) from mesh space to the scene, for each joint of a skin."""
    joints, matrices = _skin_joints(file, skin), file.document.item("skins", skin).index("inverseBindMatrices")
    inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if matrices is not None:
        stored = file.accessor(matrices)
        if len(stored) < len(joints) or stored.shape[1] != 16 or not np.isfinite(stored).all():
            raise ContentError(
                f"skin {skin} has {len(joints)} joints and {len(stored)} inverse bind matrices of {stored.shape[1]} "
                "numbers; each joint needs a finite one of 16"
            )
        inverse_bind = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    return (file.node_worlds[joints] @ inverse_bind)[:, :3]


def _joint_tails(file: GltfFile, joint_nodes: list[int]) -> np.ndarray:
    """(j, 3) place of a joint's child node named `JOINT_end` (as modelling tools export leaf bones), else NaN."""
    tails = np.full((len(joint_nodes), 3), np.nan)
    for joint, node in enumerate(joint_nodes):
        end = f"{file.nodes[node].text('name')}{END_SUFFIX}"
        for child in file.node_children[node]:
            if file.nodes[child].text("name") == end:
                tails[joint] = file.node_worlds[child][:3, 3]
    return tails


def _frame(file: GltfFile) -> np.ndarray:
    """(3, 3) from the file's frame to the root frame."""
    extensions = file.document.entry("extensions")
    return VRM0_TO_ROOT_FRAME if "VRM" in extensions and "VRMC_vrm" not in extensions else TO_ROOT_FRAME
