"""Write a skinned body as glTF 2.0 or VRM: the demo avatar, and the files the loader's tests read.

Dimensions: `V` vertices, `f` faces, `j` joints, `K` influences. Input in metres, root frame (X forward, Y left, Z up).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from physkin_core.export.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, strongest_influences

__all__ = ["skinned_document"]

NAME, LICENCE = "PhySkin", "https://vrm.dev/licenses/1.0/"
"""What a VRM says of itself: readers refuse one that does not."""


def skinned_document(
    vertices: np.ndarray,
    faces: np.ndarray,
    joint_names: Sequence[str],
    joint_parents: Sequence[int],
    joint_heads: np.ndarray,
    influence_joints: np.ndarray,
    influence_weights: np.ndarray,
    *,
    joint_ends: Mapping[str, np.ndarray] | None = None,
    humanoid: Mapping[str, str] | None = None,
    vrm_version: str = "1.0",
    asset: Mapping[str, str] | None = None,
) -> GltfBuilder:
    """One mesh and its skeleton, joints without rotation, the given pose as bind pose; the 4 strongest influences.

    vertices: (V, 3) [m]. faces: (f, 3). joint_parents: index, -1 for the root. joint_heads: (j, 3) [m].
    influence_joints, influence_weights: (V, K). joint_ends: far end (3,) of leaf joints, stored as nodes `NAME_end`.
    humanoid: joint name by VRM humanoid bone, makes a VRM of `vrm_version` "1.0" or "0.x" (which faces -Z).
    """
    frame = FROM_ROOT_FRAME
    if humanoid and vrm_version == "0.x":
        frame = np.diag([-1.0, 1.0, -1.0]) @ frame
    heads = joint_heads @ frame.T
    joints, weights = strongest_influences(influence_joints, influence_weights)

    builder = GltfBuilder(asset or {})
    attributes = {
        "POSITION": builder.add_accessor((vertices @ frame.T).astype(np.float32)),
        "JOINTS_0": builder.add_accessor(joints.astype(np.uint8)),
        "WEIGHTS_0": builder.add_accessor(weights, normalized=True),
    }
    index_type = np.uint16 if len(vertices) <= 65535 else np.uint32
    indices = builder.add_accessor(faces.astype(index_type).reshape(-1))
    bind = np.tile(np.eye(4), (len(heads), 1, 1))
    bind[:, :3, 3] = -heads
    inverse_bind = builder.add_accessor(bind.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))

    nodes = []
    for name, parent, head in zip(joint_names, joint_parents, heads):
        nodes.append({"name": name, "translation": (head - heads[parent] if parent >= 0 else head).tolist()})
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(len(nodes) - 1)
    for name, end in (joint_ends or {}).items():
        joint = list(joint_names).index(name)
        nodes[joint].setdefault("children", []).append(len(nodes))
        nodes.append({"name": f"{name}_end", "translation": (frame @ end - heads[joint]).tolist()})
    roots = [joint for joint, parent in enumerate(joint_parents) if parent < 0]
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    builder.document |= {
        "scene": 0,
        "scenes": [{"nodes": [*roots, len(nodes) - 1]}],
        "nodes": nodes,
        "meshes": [{"name": "body", "primitives": [{"attributes": attributes, "indices": indices}]}],
        "skins": [{"joints": list(range(len(heads))), "inverseBindMatrices": inverse_bind}],
    }
    if humanoid:
        bones = {bone: list(joint_names).index(name) for bone, name in humanoid.items()}
        _add_vrm(builder.document, bones, vrm_version)
    return builder


def _add_vrm(document: dict, bones: Mapping[str, int], version: str) -> None:
    if version == "1.0":
        humanoid = {"humanBones": {bone: {"node": node} for bone, node in bones.items()}}
        meta = {"name": NAME, "version": "1", "authors": [NAME], "licenseUrl": LICENCE}
        document["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": humanoid}}
    elif version == "0.x":
        humanoid = {"humanBones": [{"bone": bone, "node": node} for bone, node in bones.items()]}
        document["extensions"] = {"VRM": {"specVersion": "0.0", "meta": {"title": NAME}, "humanoid": humanoid}}
    else:
        raise ValueError(f"VRM version {version!r}, allowed are '1.0' and '0.x'")
    document["extensionsUsed"] = list(document["extensions"])
