"""Write a skinned body as glTF 2.0: the demo avatar, and the files the loader's tests read.

Dimensions: `V` vertices, `f` faces, `j` joints, `K` influences. Input in metres, root frame (X forward, Y left, Z up).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, strongest_influences

__all__ = ["skinned_document"]


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
    asset: Mapping[str, str] | None = None,
) -> GltfBuilder:
    """One mesh and its skeleton, joints without rotation, the given pose as bind pose; the 4 strongest influences.

    vertices: (V, 3) [m]. faces: (f, 3). joint_parents: index, -1 for the root. joint_heads: (j, 3) [m].
    influence_joints, influence_weights: (V, K). joint_ends: far end (3,) of leaf joints, stored as nodes `NAME_end`.
    """
    frame = FROM_ROOT_FRAME
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
    return builder
