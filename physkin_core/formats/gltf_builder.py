"""glTF 2.0 files: a document and its binary buffer while they grow, and how they are written.

Dimensions: `N` elements of an accessor. Metres. Our root frame has X forward, Y left, Z up; glTF has x left, y up, z
forward.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

__all__ = ["FROM_ROOT_FRAME", "GltfBuilder", "glb", "strongest_influences", "write_glb"]

# Rows: glTF's x (left), y (up), z (forward).
FROM_ROOT_FRAME = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
COMPONENT_TYPES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
WIDTH_NAMES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
STORED_INFLUENCES = 4


class GltfBuilder:
    """A glTF document and its binary buffer while they grow."""

    def __init__(self, asset: Mapping[str, str]) -> None:
        self.document: dict = {"asset": {"version": "2.0", **asset}, "buffers": [{"byteLength": 0}]}
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

    def add_sparse_accessor(self, indices: np.ndarray, values: np.ndarray, count: int) -> int:
        """Append a (count, 3) array that is zero but for rows `indices` (k,), which hold values (k, 3), in order of
        index, as it is if these are all rows; returns the accessor's index."""
        if len(values) == count:
            return self.add_accessor(values)
        everywhere = np.concatenate([values, np.zeros((1, 3), dtype=values.dtype)])
        accessor = {
            "componentType": COMPONENT_TYPES[values.dtype.name],
            "count": count,
            "type": WIDTH_NAMES[3],
            "min": everywhere.min(axis=0).tolist(),
            "max": everywhere.max(axis=0).tolist(),
            "sparse": {
                "count": len(values),
                "indices": {
                    "bufferView": self.add_view(indices.astype(np.uint32)),
                    "componentType": COMPONENT_TYPES["uint32"],
                },
                "values": {"bufferView": self.add_view(values)},
            },
        }
        self.document["accessors"].append(accessor)
        return len(self.document["accessors"]) - 1


def strongest_influences(joints: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The 4 strongest of skinning's influences (V, K), as glTF stores them: joints (V, 4) uint16, weights (V, 4) uint16
    whose rows sum to 65535."""
    strongest = np.argsort(-weights, axis=1, kind="stable")[:, :STORED_INFLUENCES]
    strongest = np.pad(strongest, ((0, 0), (0, max(0, STORED_INFLUENCES - strongest.shape[1]))))
    chosen = np.take_along_axis(weights, strongest, axis=1)
    chosen[:, weights.shape[1] :] = 0
    chosen = chosen / chosen.sum(axis=1, keepdims=True)
    stored = np.where(chosen > 0, np.take_along_axis(joints, strongest, axis=1), 0).astype(np.uint16)
    integers = np.round(chosen * 65535).astype(np.int64)
    integers[:, 0] += 65535 - integers.sum(axis=1)  # else vertices would shrink towards the origin
    return stored, integers.astype(np.uint16)


def write_glb(path: Path, builder: GltfBuilder) -> None:
    """Write one binary file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(glb(builder))


def glb(builder: GltfBuilder) -> bytes:
    """One binary file, JSON and buffer together."""
    text = json.dumps(builder.document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary = bytes(builder.binary) + b"\0" * (-len(builder.binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
