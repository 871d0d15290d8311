"""Network weights as the garment model file stores them: ten bits each, or eight.

A weight (out, in) is rounded to whole steps from -511 to 511 and becomes three tensors:

    NAME            int8     (out, in)            the upper eight bits of the steps, two's complement
    NAME.low        uint8    (out, ceil(in / 4))  the lower two of columns 4 k to 4 k + 3, the first in the lowest bits
    NAME.largest    float16  (out, 4)             511 steps of a row's columns 4 k, 4 k + 1, 4 k + 2 and 4 k + 3

A weight whose rows lie on 127 steps to their largest already, as compensated rounding leaves them, takes eight bits and
loses nothing. Of many rows it leaves only every few steps, and the largest:

    NAME             int8     (out, in)  how often so many steps, at most 127 in all
    NAME.every       uint8    (out, 1)   how many of a row's steps that is; not there where it is 1 in all rows
    NAME.largest_127 float16  (out, 1)   127 of a row's steps

In ten bits a row has four scales, since the node deformer's first layer reads transforms of 3 x 4 numbers and weighs
their translations several times as much as the rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

__all__ = ["MOST_STEPS", "MOST_STEPS_IN_8_BITS", "pack_weight", "unpack_weights"]

MOST_STEPS, MOST_STEPS_IN_8_BITS = 511, 127
"""Of the largest of a row's columns 4 k, 4 k + 1, ..., each with a scale of its own; and of that of a whole row, as
native/src/kernels/packed_layer.cpp rounds."""
ON_A_STEP = 0.3
"""How far a weight may be from one of the 127 steps, in steps, to lie on it: half precision and ten bits move it."""
FIRST_BITS = np.arange(0, 8, 2, dtype=np.uint8)
"""Where the low bits of each of four columns begin in their byte."""
LOW_BITS = (np.arange(256, dtype=np.uint8)[:, None] >> FIRST_BITS & 3).view(np.uint32)[:, 0]
"""(256,) the four numbers that a byte holds, a byte each: looked up as one word, they unpack fast."""


def pack_weight(name: str, weight: np.ndarray) -> dict[str, np.ndarray]:
    """The tensors that store a network weight (out, in), by name; their scales are inf beyond half precision."""
    outputs, inputs = weight.shape
    row = np.abs(weight).max(axis=1, keepdims=True).astype(np.float16)
    in_steps = weight / np.where(row > 0, row, 1).astype(np.float32) * MOST_STEPS_IN_8_BITS
    if np.isfinite(row).all() and np.abs(in_steps - np.rint(in_steps)).max() < ON_A_STEP:
        return _on_steps(name, np.rint(in_steps).clip(-MOST_STEPS_IN_8_BITS, MOST_STEPS_IN_8_BITS), row)
    fours = np.pad(weight, ((0, 0), (0, -inputs % 4))).reshape(outputs, -1, 4)
    largest = np.abs(fours).max(axis=1).astype(np.float16)
    step = largest[:, None].astype(np.float32) / MOST_STEPS
    steps = np.rint(fours / np.where(step > 0, step, 1)).clip(-MOST_STEPS, MOST_STEPS).astype(np.int16)
    return {
        name: (steps >> 2).astype(np.int8).reshape(outputs, -1)[:, :inputs],
        f"{name}.low": ((steps & 3).astype(np.uint8) << FIRST_BITS).sum(axis=2, dtype=np.uint8),
        f"{name}.largest": largest,
    }


def _on_steps(name: str, steps: np.ndarray, row: np.ndarray) -> dict[str, np.ndarray]:
    """The tensors of whole steps (out, in) from -127 to 127 of rows with such a largest (out, 1)."""
    below = np.where(np.abs(steps) < MOST_STEPS_IN_8_BITS, steps, 0).astype(np.int32)
    every = np.gcd.reduce(below, axis=1, keepdims=True)
    every[every == 0] = 1
    often = np.sign(steps) * np.ceil(np.abs(steps) / every)  # the largest, which may lie between, beyond itself
    stored = {name: often.astype(np.int8), f"{name}.largest_127": row}
    return stored if (every == 1).all() else {**stored, f"{name}.every": every.astype(np.uint8)}


def unpack_weights(tensors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """All tensors of a file, each network weight stored as two or three being one again (out, in) float32.

    Raises KeyError when one of them is missing, ValueError when a shape, a type or a value of NAME.largest is not
    as stated above.
    """
    unpacked = dict(tensors)
    for name, high in tensors.items():
        on_steps = f"{name}.largest_127" in tensors
        if high.dtype == np.int8 and (on_steps or name.endswith(".weight")):
            if on_steps:
                every = unpacked.pop(f"{name}.every", None)
                unpacked[name] = _unpacked(name, high, None, unpacked.pop(f"{name}.largest_127"), every)
            else:
                unpacked[name] = _unpacked(name, high, unpacked.pop(f"{name}.low"), unpacked.pop(f"{name}.largest"))
    return unpacked


def _unpacked(
    name: str, high: np.ndarray, low: np.ndarray | None, largest: np.ndarray, every: np.ndarray | None = None
) -> np.ndarray:
    if high.ndim != 2:
        raise ValueError(f"{name} has shape {high.shape}, expected two dimensions")
    outputs, inputs = high.shape
    fours = -(-inputs // 4)
    if low is None:
        parts = [("largest_127", largest, np.float16, (outputs, 1))]
        if every is not None:
            parts.insert(0, ("every", every, np.uint8, (outputs, 1)))
    else:
        parts = [("low", low, np.uint8, (outputs, fours)), ("largest", largest, np.float16, (outputs, 4))]
    for part, tensor, dtype, shape in parts:
        if tensor.shape != shape or tensor.dtype != dtype:
            raise ValueError(
                f"{name}.{part} is {tensor.dtype} of shape {tensor.shape}, expected {np.dtype(dtype)} of shape {shape}"
            )
    if wrong := largest[~(np.isfinite(largest) & (largest >= 0))].tolist():
        raise ValueError(f"{name}.{parts[-1][0]} holds {wrong[0]}, allowed: a finite number, 0 or more")
    if low is None:
        if every is not None:
            high = np.multiply(high, every, dtype=np.int16)
            np.clip(high, -MOST_STEPS_IN_8_BITS, MOST_STEPS_IN_8_BITS, out=high)
        return high * (largest.astype(np.float32) / MOST_STEPS_IN_8_BITS)
    steps = np.multiply(high, 4, dtype=np.int16)
    steps += LOW_BITS[low].view(np.uint8)[:, :inputs]
    return steps * np.tile(largest.astype(np.float32) / MOST_STEPS, fours)[:, :inputs]
