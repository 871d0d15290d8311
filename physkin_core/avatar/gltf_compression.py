"""Compressed parts of glTF files: buffer views by meshoptimizer, primitives by Draco; each through a binding of it.

The bindings are small, but of compiled code, so they come with the extra `compressed`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType

import numpy as np

from physkin_core.avatar.avatar import AvatarError
from physkin_core.extras import install_command

__all__ = ["DRACO", "draco_mesh", "meshopt_extension", "meshopt_view"]

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
LARGEST_VIEW = 1 << 28
"""[bytes] that a buffer view may decode to."""


def meshopt_extension(extensions: Mapping | None) -> dict | None:
    """What one of meshoptimizer's extensions says among those of a buffer or a buffer view."""
    return next((extensions[name] for name in MESHOPT if extensions and name in extensions), None)


def meshopt_view(extension: Mapping, data: bytes, source: str) -> bytes:
    """A buffer view as it was before it was compressed.

    extension: the view's; its filters are undone, too. data: of the buffer that it names.
    Raises AvatarError when it is malformed, too large, or meshoptimizer is not installed.
    """
    meshopt = _binding("meshopt", MESHOPT[0], source)
    start, count, stride = extension.get("byteOffset", 0), extension["count"], extension["byteStride"]
    end = start + extension["byteLength"]
    if not (0 <= start <= end <= len(data) and 0 < count * stride <= LARGEST_VIEW):
        raise AvatarError(
            f"avatar {source}: a compressed buffer view of {count} times {stride} bytes is at bytes {start} to {end}; "
            f"allowed are {len(data)} bytes, and {LARGEST_VIEW} when decoded"
        )
    try:
        rows = meshopt.decode_gltf_buffer(data[start:end], count, stride, extension["mode"], extension.get("filter"))
    except Exception as error:  # whatever the decoder trips over, the file is malformed
        raise AvatarError(f"avatar {source}: a compressed buffer view is malformed: {error}") from error
    return np.ascontiguousarray(rows).tobytes()


def draco_mesh(data: bytes, source: str):
    """DracoPy's mesh of a primitive's bytes. Raises AvatarError when they are malformed or it is not installed."""
    draco = _binding("DracoPy", DRACO, source)
    try:
        return draco.decode(data)
    except Exception as error:  # whatever the decoder trips over, the file is malformed
        raise AvatarError(f"avatar {source}: a primitive's {DRACO} is malformed: {error}") from error


def _binding(name: str, extension: str, source: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise AvatarError(
            f"avatar {source} is compressed with {extension}; to read it: {install_command('compressed')} ({name})"
        ) from error
