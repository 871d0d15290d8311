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
    entries = _entries(plain.pop(DEFLATED, "{}"))
    for name, entry in entries.items():
        if name not in tensors:
            raise ContentError(f"it lacks {shown(name)}, which its metadata name among what is deflated")
        dtype, shape, kind = _described(name, entry)
        size = math.prod(shape) * dtype.itemsize
        if size > MOST_INFLATED * tensors[name].nbytes:
            raise ContentError(f"{shown(name)} cannot be {shown(size)} bytes, deflated to {tensors[name].nbytes}")
        planes = np.frombuffer(_inflate(name, tensors[name], size), np.uint8).reshape(dtype.itemsize, -1)
        tensor = np.ascontiguousarray(planes.T).view(dtype).reshape(shape)
        if kind != "plain":
            tensor = np.cumsum(tensor, axis=0 if kind == "rows" else None, dtype=dtype).reshape(shape)
        inflated[name] = tensor
    return plain, inflated


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


def _entries(text: str) -> dict[str, object]:
    try:
        entries = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ContentError(f"its metadata entry {DEFLATED!r} is not JSON: {error}") from error
    if not isinstance(entries, dict):
        raise ContentError(f"its metadata entry {DEFLATED!r} is {shown(entries)}, expected an object of tensors")
    return entries


def _described(name: str, entry: object) -> tuple[np.dtype, tuple[int, ...], str]:
    """Type, shape and kind of an entry."""
    match entry:
        case [str(dtype), [_, *_] as shape, str(kind)] if dtype in TYPES and kind in KINDS:
            whole = all(type(size) is int and size >= 0 for size in shape)
            if whole and (kind == "plain" or TYPES[dtype].kind in "iu"):
                return TYPES[dtype], tuple(shape), kind
    raise ContentError(
        f"its metadata say {shown(entry)} of {shown(name)}, allowed: [type, shape, kind], types {', '.join(TYPES)}, "
        f"kinds {', '.join(KINDS)}, all but the first of whole numbers"
    )


def _inflate(name: str, stream: np.ndarray, size: int) -> bytes:
    if stream.dtype != np.uint8 or stream.ndim != 1:
        raise ContentError(
            f"{shown(name)} is {stream.dtype} of shape {stream.shape}, expected uint8 (bytes,), deflated"
        )
    inflate = zlib.decompressobj(RAW)
    try:
        content = inflate.decompress(stream.tobytes(), size + 1)
    except zlib.error as error:
        raise ContentError(f"{shown(name)} cannot be inflated: {error}") from error
    if len(content) != size or not inflate.eof or inflate.unused_data:
        raise ContentError(f"{shown(name)} does not inflate to the {size} bytes that its metadata say")
    return content
