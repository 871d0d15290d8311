"""Safetensors files from anywhere: garment models and clips are read from their bytes, and sealed.

The seal is a SHA-256 digest over all metadata and tensors.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from physkin_core.file_reading import ContentError

__all__ = ["DIGEST", "content_digest", "read_tensors", "write_tensors"]

DIGEST = "sha256"
"""Metadata entry of the digest."""
LARGEST_HEADER = 1 << 22
"""[bytes] Names, types, shapes and metadata of the shipped garment models take 110,000."""


def read_tensors(content: bytes) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Metadata and tensors of a file's bytes, as they are: what they mean is for the caller to check.

    Raises ContentError for bytes that are cut off, damaged or no such file, a header that is too large, and a type
    that NumPy lacks.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    header = int.from_bytes(content[:8], "little")
    if LARGEST_HEADER < header <= len(content):
        raise ContentError(f"its header has {header} bytes; at most {LARGEST_HEADER} are read")
    try:
        tensors = load(content)
        metadata = json.loads(content[8 : 8 + header]).get("__metadata__")
    except KeyError as error:  # what the library says of a type
        raise ContentError(f"it holds an array of type {error.args[0]}, which NumPy lacks") from error
    except (SafetensorError, ValueError, OverflowError, RecursionError) as error:
        raise ContentError(f"it cannot be read as safetensors: {error}") from error
    return metadata or {}, tensors


def content_digest(metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of metadata, but for the digest itself, and tensors with their names, types and shapes."""
    digest = hashlib.sha256()
    for key in sorted(set(metadata) - {DIGEST}):
        digest.update(f"{key}\0{metadata[key]}\0".encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name}\0{tensor.dtype.str}\0{tensor.shape}\0".encode())
        digest.update(np.ascontiguousarray(tensor).tobytes())
    return digest.hexdigest()


def write_tensors(path: Path, metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]) -> None:
    """Write a file with its digest, replacing what is there in one step."""
    from safetensors.numpy import save

    tensors = {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(save(tensors, metadata={**metadata, DIGEST: content_digest(metadata, tensors)}))
    partial.replace(path)
