"""Write a skinned body as glTF 2.0 or VRM: the demo avatar, and the files the loader's tests read.

Dimensions: `V` vertices, `f` faces, `j` joints, `K` influences. Input in metres, root frame (X forward, Y left, Z up).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

__all__ = ["GltfBuilder", "skinned_document", "write_glb", "write_gltf"]

# Rows: glTF's x (left), y (up), z (forward).
FROM_ROOT_FRAME = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
COMPONENT_TYPES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
WIDTH_NAMES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
STORED_INFLUENCES = 4


class GltfBuilder:
    """A glTF document and its binary buffer while they grow."""

    def __init__(self, asset: Mapping[str, str]) -> None:
        self.document: dict = {"asset": {"version": "2.0", **asset}, "buffers": [{}]}
        self.document |= {"bufferViews": [], "accessors": []}
        self.binary = bytearray()

    def add_view(self, array: np.ndarray) -> int:
        """Append an array's bytes; returns the buffer view's index."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        data = np.ascontiguousarray(array).tobytes()
        self.document["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data
        self.document["buffers"][0]["byteLength"] = len(self.binary)
        return len(self.document["bufferViews"]) - 1

    def add_accessor(self, array: np.ndarray, *, normalized: bool = False) -> int:
        """Append an (N,) or (N, width) array; returns the accessor's index."""
        array = array.reshape(len(array), -1)
        accessor = {
            "bufferView": self.add_view(array),
            "componentType": COMPONENT_TYPES[array.dtype.name],
            "count": len(array),
            "type": WIDTH_NAMES[array.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        if array.shape[1] == 3:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.document["accessors"].append(accessor)
        return len(self.document["accessors"]) - 1


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
    strongest = np.argsort(-influence_weights, axis=1, kind="stable")[:, :STORED_INFLUENCES]
    strongest = np.pad(strongest, ((0, 0), (0, max(0, STORED_INFLUENCES - strongest.shape[1]))))
    joints = np.take_along_axis(influence_joints, strongest, axis=1)
    weights = np.take_along_axis(influence_weights, strongest, axis=1)
    weights[:, influence_weights.shape[1] :] = 0
    weights = weights / weights.sum(axis=1, keepdims=True)

    builder = GltfBuilder(asset or {})
    attributes = {
        "POSITION": builder.add_accessor((vertices @ frame.T).astype(np.float32)),
        "JOINTS_0": builder.add_accessor(np.where(weights > 0, joints, 0).astype(np.uint8)),
        "WEIGHTS_0": builder.add_accessor(_weights_as_integers(weights), normalized=True),
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


def write_glb(path: Path, builder: GltfBuilder) -> None:
    """Write one binary file, JSON and buffer together."""
    text = json.dumps(builder.document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary = bytes(builder.binary) + b"\0" * (-len(builder.binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def write_gltf(path: Path, builder: GltfBuilder, *, buffer_uri: str) -> None:
    """Write the JSON alone; `buffer_uri` is where its buffer is found (a file beside it, or a data URI)."""
    document = {**builder.document, "buffers": [{**builder.document["buffers"][0], "uri": buffer_uri}]}
    path.write_text(json.dumps(document), encoding="utf-8")


def _weights_as_integers(weights: np.ndarray) -> np.ndarray:
    """uint16 whose rows sum to exactly 65535, so that vertices do not shrink towards the origin."""
    stored = np.round(weights * 65535).astype(np.int64)
    stored[:, 0] += 65535 - stored.sum(axis=1)
    return stored.astype(np.uint16)


def _add_vrm(document: dict, bones: Mapping[str, int], version: str) -> None:
    if version == "1.0":
        humanoid = {"humanBones": {bone: {"node": node} for bone, node in bones.items()}}
        document["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "humanoid": humanoid}}
    elif version == "0.x":
        humanoid = {"humanBones": [{"bone": bone, "node": node} for bone, node in bones.items()]}
        document["extensions"] = {"VRM": {"specVersion": "0.0", "humanoid": humanoid}}
    else:
        raise ValueError(f"VRM version {version!r}, allowed are '1.0' and '0.x'")
    document["extensionsUsed"] = list(document["extensions"])
