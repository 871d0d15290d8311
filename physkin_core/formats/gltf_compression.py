"""Compressed parts of glTF files: buffer views by meshoptimizer, primitives by Draco; each through a binding of it.

The bindings are small, but of compiled code, so they come with the extra `compressed`.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

import numpy as np

from physkin_core.extras import install_command
from physkin_core.file_reading import ContentError
from physkin_core.formats.gltf_document import GltfEntry

__all__ = ["DRACO", "DracoMesh", "draco_mesh", "meshopt_extension", "meshopt_view"]

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MESHOPT_MODES = {name: name for name in ("ATTRIBUTES", "TRIANGLES", "INDICES")}
MESHOPT_FILTERS = {name: name for name in ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")}

DracoMesh = object
"""DracoPy's mesh."""


def meshopt_extension(entry: GltfEntry) -> GltfEntry | None:
    """What one of meshoptimizer's extensions says of a buffer or a buffer view."""
    extensions = entry.entry("extensions")
    return next((extensions.entry(name) for name in MESHOPT if name in extensions), None)


def meshopt_view(extension: GltfEntry, length: int, data: bytes) -> bytes:
    """A buffer view as it was before it was compressed.

    extension: the view's; its filters are undone, too. length: the view's [bytes]. data: of the buffer that it names.
    Raises ContentError when it is malformed, or meshoptimizer is not installed.
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
    try:
        rows = meshopt.decode_gltf_buffer(data[start:end], count, stride, mode, undone)
    except Exception as error:  # whatever the decoder trips over, the file is malformed
        raise ContentError(f"a compressed buffer view is malformed: {error}") from error
    return np.ascontiguousarray(rows).tobytes()


def draco_mesh(data: bytes) -> DracoMesh:
    """The mesh in a primitive's bytes. Raises ContentError when they are malformed, or DracoPy is not installed."""
    draco = _binding("DracoPy", DRACO)
    try:
        return draco.decode(data)
    except Exception as error:  # whatever the decoder trips over, the file is malformed
        raise ContentError(f"a primitive's {DRACO} is malformed: {error}") from error


def _binding(name: str, extension: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise ContentError(
            f"it is compressed with {extension}; to read it: {install_command('compressed')} ({name})"
        ) from error
