"""Avatars from glTF 2.0: GLB, glTF and VRM (0.x and 1.0) files.

The mesh is taken as the file shows it (node transforms, default morph weights, skinning), with its own joint hierarchy;
`retargeting` then puts it into the canonical pose. A file without a skin is a plain mesh.

Dimensions: `V` vertices, `j` joints (see `_joints`), `g` nodes, `K` influences.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.avatar.gltf_file import GltfFile
from physkin_core.avatar.mesh_avatar import retarget_plain_mesh
from physkin_core.avatar.retargeting import retarget
from physkin_core.avatar.skinned_mesh import SkinnedMesh, Surface, clean_surface, unit_scale
from physkin_core.rig.linear_blend_skinning import joined_influences, linear_blend_skinning
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["load_gltf", "primitives"]

# Rows: X forward, Y left, Z up. glTF and VRM 1.0 are Y up and face +Z; VRM 0.x faces -Z.
TO_ROOT_FRAME = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
VRM0_TO_ROOT_FRAME = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
END_SUFFIX = "_end"


def load_gltf(path: Path, rig: Rig, *, rig_file: str | Path | None = None) -> Avatar:
    """Read a GLB, glTF or VRM file. Raises AvatarError (see `physkin_core.load_avatar`)."""
    try:
        file = GltfFile(path)
        if file.document.skins and rig_file is not None:
            raise AvatarError(f"avatar {path} has its own skeleton; a rig file ({rig_file}) is for plain meshes")
        mesh = _skinned_mesh(file) if file.document.skins else _plain_mesh(file)
    except AvatarError:
        raise
    except (AttributeError, IndexError, KeyError, MemoryError, TypeError, ValueError) as error:
        raise AvatarError(f"avatar {path} is malformed: {type(error).__name__}: {error}") from error
    if isinstance(mesh, Surface):
        return retarget_plain_mesh(mesh, rig, path=path, rig_file=rig_file, up="Y")
    return retarget(mesh, rig)


def _plain_mesh(file: GltfFile) -> Surface:
    """All meshes of a file without skins, in glTF's frame."""
    parts, start = [], 0
    for node, primitive, positions, faces, _ in primitives(file):
        placed = _in_scene(file, node, positions)
        parts.append((placed, faces + start, _part_names(file, node, primitive), _is_clear(file, primitive)))
        start += len(positions)
    if not parts:
        raise AvatarError(f"avatar {file.path} has no faces; a triangle mesh is needed")
    vertices, faces, names, clear = zip(*parts)
    face_parts = np.repeat(np.arange(len(parts)), list(map(len, faces)))
    clear_parts = frozenset(np.flatnonzero(clear).tolist())
    return Surface(np.concatenate(vertices), np.concatenate(faces), names, face_parts, clear_parts)


def _skinned_mesh(file: GltfFile) -> SkinnedMesh:
    humanoid = _humanoid_nodes(file)
    joint_nodes, node_joint = _joints(file, humanoid or {})
    frame = _frame(file)
    warnings, parts, start = [], [], 0
    for node, primitive, positions, faces, corners in primitives(file):
        label = file.document.nodes[node].name or f"node {node}"
        skin = file.document.nodes[node].skin
        if skin is not None:
            joints, weights, unbound = _skin_influences(file, primitive, skin, len(positions), label)
            if unbound:
                warnings.append(f"{unbound} vertices of {label!r} have no skinning weights: bound to the first joint")
            positions = linear_blend_skinning(positions, _skin_transforms(file, skin), joints, weights)
            joints = np.array([node_joint[joint] for joint in file.document.skins[skin].joints])[joints]
        else:
            carrier = next(
                (node_joint[each] for each in ancestors(file.node_parents, node) if each in node_joint), None
            )
            if carrier is None:
                warnings.append(f"mesh {label!r} has no skin and hangs on no joint: left out")
                continue
            positions = _in_scene(file, node, positions)
            joints, weights = np.full((len(positions), 1), carrier), np.ones((len(positions), 1))
        named = _part_names(file, node, primitive), _is_clear(file, primitive)
        parts.append((positions, faces + start, joints, weights, corners, *named))
        start += len(positions)
    if not parts:
        raise AvatarError(f"avatar {file.path} has no faces on its skeleton; a triangle mesh is needed")
    vertices, faces, joints, weights, corners, names, clear = zip(*parts)
    face_parts = np.repeat(np.arange(len(parts)), list(map(len, faces)))
    vertices, faces, corners = map(np.concatenate, (vertices, faces, corners))
    influences = joined_influences(joints), joined_influences(weights)
    vertices, faces, (joints, weights), kept = clean_surface(vertices, faces, influences, str(file.path))
    heads = file.node_worlds[joint_nodes][:, :3, 3]
    scale, unit_warning = unit_scale(vertices)
    frame = scale * frame
    return SkinnedMesh(
        vertices=vertices @ frame.T,
        faces=faces,
        joint_names=tuple(file.document.nodes[node].name or f"node {node}" for node in joint_nodes),
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
        file_vertices=vertices,
        file_corners=corners[kept],
    )


def primitives(file: GltfFile):
    """Everything with faces in the scene: node, primitive, positions (V, 3) in mesh space with default morph weights
    applied, faces (f, 3) as the scene shows them, and numbers of their corners (f, 3), counted over the whole file."""
    count = 0
    for node in file.scene_nodes():
        if file.document.nodes[node].mesh is None:
            continue
        mesh = file.document.meshes[file.document.nodes[node].mesh]
        morph = mesh.weights or []
        for primitive in mesh.primitives:
            if primitive.attributes.POSITION is None or len(file.triangles(primitive)) == 0:
                continue
            positions = file.attribute(primitive, "POSITION").astype(np.float64)
            for weight, target in zip(morph, primitive.targets or []):
                offset = target.get("POSITION") if isinstance(target, dict) else target.POSITION
                if weight and offset is not None:
                    positions = positions + weight * file.accessor(offset)
            mirrored = file.document.nodes[node].skin is None and np.linalg.det(file.node_worlds[node][:3, :3]) < 0
            faces = _faces(file, primitive, positions, mirrored=mirrored)
            yield node, primitive, positions, faces, count + np.arange(faces.size).reshape(-1, 3)
            count += faces.size


def _in_scene(file: GltfFile, node: int, positions: np.ndarray) -> np.ndarray:
    """Positions (V, 3) of a node's mesh where its transform puts them."""
    world = file.node_worlds[node]
    return positions @ world[:3, :3].T + world[:3, 3]


def _part_names(file: GltfFile, node: int, primitive) -> tuple[str, ...]:
    """Names of a primitive's material, mesh and node, those that there are."""
    document = file.document
    material = None if primitive.material is None else document.materials[primitive.material].name
    named = document.nodes[node]
    return tuple(name for name in (material, document.meshes[named.mesh].name, named.name) if name) or (f"node {node}",)


def _is_clear(file: GltfFile, primitive) -> bool:
    """Whether what is behind a primitive shows through, as through lenses and the cards of lashes."""
    return primitive.material is not None and file.document.materials[primitive.material].alphaMode == "BLEND"


def _faces(file: GltfFile, primitive, positions: np.ndarray, *, mirrored: bool) -> np.ndarray:
    faces = file.triangles(primitive)
    if faces.min() < 0 or faces.max() >= len(positions):
        raise AvatarError(
            f"avatar {file.path}: face indices span {faces.min()} to {faces.max()}, allowed 0 to {len(positions) - 1}"
        )
    return faces[:, ::-1] if mirrored else faces


def _joints(file: GltfFile, humanoid: dict[str, int]) -> tuple[list[int], dict[int, int]]:
    """Nodes of the skeleton, parents first, and the joint index of each.

    These are all skins' joints, the VRM humanoid bones (a skin need not use them all), and their ancestors.
    """
    joints = [*humanoid.values(), *(joint for skin in file.document.skins for joint in skin.joints)]
    nodes = {node for joint in set(joints) for node in ancestors(file.node_parents, joint)}
    joint_nodes = [node for node in file.node_order if node in nodes]
    return joint_nodes, {node: joint for joint, node in enumerate(joint_nodes)}


def _skin_influences(
    file: GltfFile, primitive, skin: int, count: int, label: str
) -> tuple[np.ndarray, np.ndarray, int]:
    """Indices into the skin's joints (V, K), weights (V, K) with rows summing to 1, and how many vertices had none."""
    joints, weights, index = [], [], 0
    while (named := file.attribute(primitive, f"JOINTS_{index}")) is not None:
        joints.append(named)
        weights.append(file.attribute(primitive, f"WEIGHTS_{index}").astype(np.float64))
        index += 1
    if not joints:
        raise AvatarError(f"avatar {file.path}: mesh {label!r} has a skin but no JOINTS_0 and WEIGHTS_0")
    joint, weight = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
    if joint.shape != weight.shape or len(joint) != count:
        raise AvatarError(
            f"avatar {file.path}: mesh {label!r} has {count} vertices, joints {joint.shape}, weights {weight.shape}; "
            "these must agree"
        )
    if not np.isfinite(weight).all() or weight.min() < 0:
        raise AvatarError(f"avatar {file.path}: skinning weights of mesh {label!r} must be finite and not negative")
    limit = len(file.document.skins[skin].joints)
    joint = np.where(weight > 0, joint, 0)
    if joint.max() >= limit:
        raise AvatarError(f"avatar {file.path}: mesh {label!r} names joint {joint.max()}, allowed 0 to {limit - 1}")
    total = weight.sum(axis=1)
    weight[total <= 0, 0] = 1.0
    return joint, weight / weight.sum(axis=1, keepdims=True), int((total <= 0).sum())


def _skin_transforms(file: GltfFile, skin: int) -> np.ndarray:
    """(joints, 3, 4) from mesh space to the scene, for each joint of a skin."""
    joints = file.document.skins[skin].joints
    inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if file.document.skins[skin].inverseBindMatrices is not None:
        stored = file.accessor(file.document.skins[skin].inverseBindMatrices)
        if len(stored) < len(joints) or not np.isfinite(stored).all():
            raise AvatarError(
                f"avatar {file.path}: skin {skin} has {len(joints)} joints and {len(stored)} inverse bind matrices; "
                "each joint needs a finite one"
            )
        inverse_bind = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    return (file.node_worlds[joints] @ inverse_bind)[:, :3]


def _joint_tails(file: GltfFile, joint_nodes: list[int]) -> np.ndarray:
    """(j, 3) place of a joint's child node named `JOINT_end` (as modelling tools export leaf bones), else NaN."""
    tails = np.full((len(joint_nodes), 3), np.nan)
    for joint, node in enumerate(joint_nodes):
        end = f"{file.document.nodes[node].name}{END_SUFFIX}"
        for child in file.document.nodes[node].children or []:
            if file.document.nodes[child].name == end:
                tails[joint] = file.node_worlds[child][:3, 3]
    return tails


def _humanoid_nodes(file: GltfFile) -> dict[str, int] | None:
    """Node by VRM humanoid bone, or None for a file that is not a VRM."""
    extensions = file.document.extensions or {}
    if "VRMC_vrm" in extensions:
        return {name: bone["node"] for name, bone in extensions["VRMC_vrm"]["humanoid"]["humanBones"].items()}
    if "VRM" in extensions:
        return {bone["bone"]: bone["node"] for bone in extensions["VRM"]["humanoid"]["humanBones"]}
    return None


def _frame(file: GltfFile) -> np.ndarray:
    """(3, 3) from the file's frame to the root frame."""
    extensions = file.document.extensions or {}
    return VRM0_TO_ROOT_FRAME if "VRM" in extensions and "VRMC_vrm" not in extensions else TO_ROOT_FRAME
