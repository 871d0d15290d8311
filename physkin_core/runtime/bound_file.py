"""The bound garment file: garments on one avatar for hosts without Python, read by native/include/physkin.h.

It holds the arrays of `BoundGarment` as the evaluator takes them, so that a host computes the same bits; fitting the
rig, the canonical pose and the encoding of the body are done by then. All of it is little-endian, without padding:

    8 bytes   MAGIC
    uint32    BOUND_FILE_VERSION
    uint32    CRC-32 of everything that follows
    pairs of texts, for hosts other than C: a name and what it says
    texts     names of joints
    uint32    number of garments, from the skin outwards; of each its name (text), those of its fabrics (texts), arrays
    uint32    number of orders, of two garments each: which stays and which yields (int32), an edge (float32), arrays

A text is its size in bytes (uint32) and UTF-8; texts and pairs begin with how many they are (uint32). Arrays come in
the order of `native.bound_garment_fields()`, or of the fields of `LayerOrder`; layers are their number (uint32), and
weights and bias of each. An array is its kind, the size of each axis (uint32) and its numbers, row by row. A matrix
whose rows lie on 127 steps to their largest, as most of shipped models do, is stored as these steps, int8, behind one
step a row (float32): their product is the matrix to the bit.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from physkin_core.native_module import native
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["BOUND_FILE_VERSION", "MAGIC", "save_bound_outfit"]

MAGIC = b"PhySkin\n"
BOUND_FILE_VERSION: int = native.constants["bound_file_version"]
FLOATS, INTEGERS, STEPS = range(3)
"""Kinds of arrays."""
MOST_STEPS = 127
"""As native/src/kernels/packed_layer.cpp rounds."""


def save_bound_outfit(
    bounds: Sequence[BoundGarment],
    path: str | Path,
    *,
    names: Sequence[str],
    joint_names: Sequence[str],
    fabrics: Sequence[Sequence[str]],
    orders: Sequence[Any] = (),
    texts: Mapping[str, str] | None = None,
) -> None:
    """Write garments bound to one body, from the skin outwards, to `path`, replacing what is there in one step.

    names: of the garments. joint_names: (d,) in the order of the joint positions. fabrics: of each garment, what it is
    bound in and its other fabrics (1 + F). orders: `LayerOrder`s, what keeps two of the garments in order. texts: for
    hosts other than C. Raises ValueError when there is not one name a garment, a degree of freedom and a fabric.
    """
    if len(names) != len(bounds):
        raise ValueError(f"{len(names)} names for {len(bounds)} garments")
    if len(joint_names) != len(bounds[0].dof_bone):
        raise ValueError(f"{len(joint_names)} joint names for {len(bounds[0].dof_bone)} degrees of freedom")
    parts = [_number(len(texts or {})), *(_text(each) for pair in (texts or {}).items() for each in pair)]
    parts += [_texts(joint_names), _number(len(bounds))]
    for bound, name, own in zip(bounds, names, fabrics, strict=True):
        if len(own) != 1 + len(bound.fabric_weights):
            raise ValueError(f"{len(own)} names for {1 + len(bound.fabric_weights)} fabrics")
        parts += [_text(name), _texts(own), *_fields(bound)]
    parts.append(_number(len(orders)))
    for order in orders:
        parts.append(struct.pack("<iif", order.steady, order.yielding, order.edge))
        parts += [_array(value) for value in vars(order).values() if isinstance(value, np.ndarray)]
    content = b"".join(parts)
    path = Path(path)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(MAGIC + struct.pack("<II", BOUND_FILE_VERSION, zlib.crc32(content)) + content)
    partial.replace(path)


def _fields(bound: BoundGarment) -> Iterator[bytes]:
    for field, kind, _ in native.bound_garment_fields():
        value = getattr(bound, field)
        if kind != "layers":
            yield _array(value)
            continue
        yield _number(len(value))
        for weight, bias in value:
            yield _array(weight) + _array(bias)


def _array(array: np.ndarray) -> bytes:
    if array.dtype == np.int32:
        return _number(INTEGERS, *array.shape) + array.tobytes()
    if array.ndim == 2 and array.size:
        step = np.abs(array).max(axis=1, keepdims=True) / np.float32(MOST_STEPS)
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.nan_to_num(np.rint(array / step)).clip(-MOST_STEPS, MOST_STEPS).astype(np.int8)
        if np.array_equal(steps * step, array):
            return _number(STEPS, *array.shape) + step.tobytes() + steps.tobytes()
    return _number(FLOATS, *array.shape) + array.tobytes()


def _number(*numbers: int) -> bytes:
    return struct.pack(f"<{len(numbers)}I", *numbers)


def _text(text: str) -> bytes:
    encoded = text.encode()
    return _number(len(encoded)) + encoded


def _texts(texts: Sequence[str]) -> bytes:
    return _number(len(texts)) + b"".join(map(_text, texts))
