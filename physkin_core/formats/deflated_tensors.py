"""Tensors deflated (RFC 1951): how the garment model file stores them in fewer bytes, without losing any.

A tensor that becomes smaller so is stored under its name as a raw deflate stream, uint8 (bytes,). The metadata entry
"deflated" says by name what it holds: [type, shape, kind]. Inflated, it is the tensor's bytes, the lowest byte of all
numbers first, then the next. They are the numbers themselves ("plain"), or of whole numbers the differences to the row
before ("rows") or to the number before ("numbers"), modulo what the type holds. Network weights on few steps take their
entropy so, and meshes half of their indices.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from physkin_core.file_reading import ContentError, shown

__all__ = ["DEFLATED", "deflate_tensors", "inflate_tensors"]

DEFLATED = "deflated"
"""Metadata entry of what is deflated."""
TYPES = {name: np.dtype(name) for name in ("|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<f2", "<f4")}
LEAST_DEFLATED = 512
"""[bytes] Smaller tensors would save less than their entry takes."""
KINDS = ("plain", "rows", "numbers")
"""Floating point numbers are plain."""
MOST_INFLATED = 1040
"""Times its own size, which no deflate stream exceeds."""
RAW, MOST_MEMORY = -zlib.MAX_WBITS, 9


def deflate_tensors(tensors: Mapping[str, np.ndarray]) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """What metadata to add, and all tensors as they are stored."""
    stored = dict(tensors)
    entries: dict[str, list] = {}
    large = {name: x for name, x in tensors.items() if x.nbytes >= LEAST_DEFLATED and x.dtype.str in TYPES}
    with ThreadPoolExecutor() as threads:  # zlib takes a core for each
        shortest = threads.map(lambda tensor: min(_ways(tensor), key=lambda way: len(way[1])), large.values())
        for (name, tensor), (kind, stream) in zip(large.items(), shortest):
            if len(stream) < tensor.nbytes:
                stored[name] = np.frombuffer(stream, np.uint8)
                entries[name] = [tensor.dtype.str, list(tensor.shape), kind]
    return {DEFLATED: json.dumps(entries)} if entries else {}, stored


def inflate_tensors(
    metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]
) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Metadata and tensors of a file as they were before they were deflated.

    Raises ContentError for an entry that makes no sense, and for a stream that is damaged or does not hold just as many
    bytes as its entry says. No more is allocated than entries say, and these no more than streams can hold.
    """
    plain, inflated = dict(metadata), dict(tensors)
    try:
        entries = dict(json.loads(plain.pop(DEFLATED, "{}")))
    except (ValueError, TypeError, RecursionError) as error:
        raise ContentError(f"its metadata entry {DEFLATED!r} is no JSON object: {error}") from error
    for name, entry in entries.items():
        try:
            inflated[name] = _inflated(tensors[name], *entry)
        except (KeyError, TypeError, ValueError, OverflowError, zlib.error) as error:
            raise ContentError(
                f"{shown(name)} cannot be inflated by [type, shape, kind] {shown(entry)}: "
                f"{type(error).__name__}: {error}"
            ) from error
    return plain, inflated


def _inflated(stream: np.ndarray, type_name: str, shape: list[int], kind: str) -> np.ndarray:
    """The tensor of a stream. Raises KeyError, TypeError, ValueError, OverflowError or zlib.error for what is none."""
    dtype = TYPES[type_name]
    size = math.prod(shape) * dtype.itemsize
    if stream.dtype != np.uint8 or kind not in KINDS[: 3 if dtype.kind in "iu" else 1]:
        raise ValueError(f"allowed are uint8 and {', '.join(KINDS)}, plain for what is not whole numbers")
    if size > MOST_INFLATED * stream.nbytes:
        raise ValueError(f"{stream.nbytes} bytes cannot hold {shown(size)}")
    inflate = zlib.decompressobj(RAW)
    content = inflate.decompress(stream.tobytes(), size + 1)
    if len(content) != size or not inflate.eof or inflate.unused_data:
        raise ValueError(f"it does not inflate to {size} bytes")
    planes = np.frombuffer(content, np.uint8).reshape(dtype.itemsize, -1)
    tensor = np.ascontiguousarray(planes.T).view(dtype).reshape(shape)
    if kind != "plain":
        tensor = np.cumsum(tensor, axis=0 if kind == "rows" else None, dtype=dtype).reshape(shape)
    return tensor


def _ways(tensor: np.ndarray) -> Iterator[tuple[str, bytes]]:
    """Kinds and streams of a tensor."""
    for kind in KINDS if tensor.dtype.kind in "iu" else KINDS[:1]:
        numbers = tensor if kind == "rows" else tensor.reshape(-1)
        if kind != "plain":
            numbers = np.diff(numbers, axis=0, prepend=np.zeros_like(numbers[:1]))
        planes = np.ascontiguousarray(numbers).view(np.uint8).reshape(-1, tensor.itemsize).T.tobytes()
        for strategy in (zlib.Z_HUFFMAN_ONLY, zlib.Z_DEFAULT_STRATEGY):
            deflate = zlib.compressobj(9, zlib.DEFLATED, RAW, MOST_MEMORY, strategy)
            yield kind, deflate.compress(planes) + deflate.flush()
