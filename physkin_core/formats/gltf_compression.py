"""Compressed parts of glTF files: buffer views by meshoptimizer, primitives by Draco; each through a binding of it.

The bindings are small, but of compiled code, so they come with the extra `compressed`. They allocate what a header
says, so headers are compared with what the document says before anything is decoded.
"""

from __future__ import annotations

import struct
from importlib import import_module
from types import ModuleType

import numpy as np

from physkin_core.extras import install_command
from physkin_core.file_reading import Budget, ContentError
from physkin_core.formats.gltf_document import GltfEntry

__all__ = ["DRACO", "DracoMesh", "draco_mesh", "meshopt_extension", "meshopt_view"]

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MESHOPT_MODES = {name: name for name in ("ATTRIBUTES", "TRIANGLES", "INDICES")}
MESHOPT_FILTERS = {name: name for name in ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")}
DRACO_MAGIC, DRACO_VERSION, TRIANGULAR_MESH = b"DRACO", (2, 2), 1
SEQUENTIAL, EDGEBREAKER = 0, 1
HAS_METADATA = 0x8000

DracoMesh = object
"""DracoPy's mesh."""


def meshopt_extension(entry: GltfEntry) -> GltfEntry | None:
    """What one of meshoptimizer's extensions says of a buffer or a buffer view."""
    extensions = entry.entry("extensions")
    return next((extensions.entry(name) for name in MESHOPT if name in extensions), None)


def meshopt_view(extension: GltfEntry, length: int, data: bytes, budget: Budget) -> bytes:
    """A buffer view as it was before it was compressed.

    extension: the view's; its filters are undone, too. length: the view's [bytes]. data: of the buffer that it names.
    Raises ContentError when it is malformed, too large, or meshoptimizer is not installed.
    """
    meshopt = _binding("meshopt", MESHOPT[0])
    start, count = extension.integer("byteOffset", 0), extension.integer("count")
    end, stride = start + extension.integer("byteLength"), extension.integer("byteStride")
    if end > len(data) or not 0 < count * stride <= length:
        raise ContentError(
            f"a compressed buffer view of {count} times {stride} bytes is at bytes {start} to {end}; "
            f"allowed are {len(data)} bytes, and {length} when decoded"
        )
    mode = extension.choice("mode", MESHOPT_MODES)
    undone = extension.choice("filter", MESHOPT_FILTERS) if "filter" in extension else None
    budget.charge(count * stride, "a compressed buffer view")
    try:
        rows = meshopt.decode_gltf_buffer(data[start:end], count, stride, mode, undone)
    except Exception as error:  # whatever the decoder trips over, the file is malformed
        raise ContentError(f"a compressed buffer view is malformed: {error}") from error
    return np.ascontiguousarray(rows).tobytes()


def draco_mesh(data: bytes, vertices: int, faces: int) -> DracoMesh:
    """The mesh in a primitive's bytes, which the document says to have so many vertices and faces.

    Raises ContentError when they say otherwise, are malformed, or DracoPy is not installed.
    """
    draco = _binding("DracoPy", DRACO)
    said_faces, said_vertices, exact = _draco_counts(data)
    if said_faces != faces or said_vertices > vertices or exact and said_vertices != vertices:
        raise ContentError(
            f"a primitive's {DRACO} has {said_vertices} vertices and {said_faces} faces, its accessors {vertices} and "
            f"{faces}; these must agree"
        )
    try:
        return draco.decode(data)
    except Exception as error:  # whatever the decoder trips over, the file is malformed
        raise ContentError(f"a primitive's {DRACO} is malformed: {error}") from error


def _draco_counts(data: bytes) -> tuple[int, int, bool]:
    """Faces and vertices that a Draco stream says it has, and whether vertices are counted as glTF does: edgebreaker
    does so before those on seams are split."""
    header = struct.Struct("<5sBBBBH")
    if len(data) < header.size:
        raise ContentError(f"a primitive's {DRACO} has {len(data)} bytes, at least {header.size} are needed")
    magic, *version, kind, method, flags = header.unpack_from(data)
    if magic != DRACO_MAGIC or tuple(version) != DRACO_VERSION or kind != TRIANGULAR_MESH or flags & HAS_METADATA:
        raise ContentError(
            f"a primitive's {DRACO} begins with {data[: header.size].hex()}; it must be a triangle mesh of Draco "
            f"bitstream {'.'.join(map(str, DRACO_VERSION))} without metadata"
        )
    if method == SEQUENTIAL:
        faces, start = _varint(data, header.size)
        return faces, _varint(data, start)[0], True
    if method == EDGEBREAKER:
        vertices, start = _varint(data, header.size + 1)  # after the kind of traversal
        return _varint(data, start)[0], vertices, False
    raise ContentError(f"a primitive's {DRACO} has encoding {method}, allowed are {SEQUENTIAL} and {EDGEBREAKER}")


def _varint(data: bytes, start: int) -> tuple[int, int]:
    """A number in groups of seven bits, the lowest first, and where it ends."""
    value = 0
    for shift in range(5):
        if start + shift >= len(data):
            break
        byte = data[start + shift]
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            return value, start + shift + 1
    raise ContentError(f"a primitive's {DRACO} is malformed: its header ends early")


def _binding(name: str, extension: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise ContentError(
            f"it is compressed with {extension}; to read it: {install_command('compressed')} ({name})"
        ) from error
