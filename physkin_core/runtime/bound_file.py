"""The bound garment file: garments on one avatar for hosts without Python, read by native/include/physkin.h.

A safetensors file of the arrays of `BoundGarment` (layers as `pose_layers.0.weight`, ...) in float32 and int32 as
the evaluator takes them, so that a host computes the same bits, sealed by a digest. Fitting the rig, the canonical pose
and the encoding of the body are done by then. A matrix whose rows lie on 127 steps to their largest, as most of shipped
models do, is stored as these steps, int8, with NAME.step (rows, 1) float32: their product is the matrix to the bit.

Garments worn over the first have their index before the names, `1.vertices`. What keeps two in order is
`order.0.contact` and so on, as `LayerOrder` has it, with `order.0.layers` (steady, yielding).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from physkin_core.native_module import native
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.tensor_file import write_tensors

__all__ = ["BOUND_SCHEMA_VERSION", "save_bound_outfit"]

FORMAT = "physkin-bound-garment"
BOUND_SCHEMA_VERSION: str = native.constants["bound_garment_version"]
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
    bound in and its other fabrics (1 + F). orders: `LayerOrder`s, what keeps two of the garments in order. texts:
    entries of metadata for hosts other than C. Raises ValueError when there is not one name a garment, a degree of
    freedom and a fabric.
    """
    if len(names) != len(bounds):
        raise ValueError(f"{len(names)} names for {len(bounds)} garments")
    if len(joint_names) != len(bounds[0].dof_bone):
        raise ValueError(f"{len(joint_names)} joint names for {len(bounds[0].dof_bone)} degrees of freedom")
    tensors: dict[str, np.ndarray] = {}
    fabric_names: dict[str, str] = {}
    for index, bound in enumerate(bounds):
        prefix = f"{index}." if index else ""
        if len(fabrics[index]) != 1 + len(bound.fabric_weights):
            raise ValueError(f"{len(fabrics[index])} names for {1 + len(bound.fabric_weights)} fabrics")
        fabric_names[f"{prefix}fabrics"] = json.dumps(list(fabrics[index]))
        for name, array in _arrays(bound):
            tensors |= _stored(prefix + name, array)
    for index, order in enumerate(orders):
        prefix = f"order.{index}."
        tensors[prefix + "layers"] = np.array([order.steady, order.yielding], dtype=np.int32)
        tensors[prefix + "edge"] = np.array([order.edge], dtype=np.float32)
        tensors |= {prefix + name: value for name, value in vars(order).items() if isinstance(value, np.ndarray)}
    metadata = {
        "format": FORMAT,
        "schema_version": BOUND_SCHEMA_VERSION,
        "garments": json.dumps(list(names)),
        "joint_names": json.dumps(list(joint_names)),
        **fabric_names,
        **(texts or {}),
    }
    write_tensors(Path(path), metadata, tensors)


def _arrays(bound: BoundGarment) -> Iterator[tuple[str, np.ndarray]]:
    """Of a bound garment, by the names that they have in the file."""
    for field, kind, _ in native.bound_garment_fields():
        value = getattr(bound, field)
        if kind != "layers":
            yield field, value
            continue
        for index, (weight, bias) in enumerate(value):
            yield f"{field}.{index}.weight", weight
            yield f"{field}.{index}.bias", bias


def _stored(name: str, array: np.ndarray) -> dict[str, np.ndarray]:
    """The tensors that store an array."""
    if array.ndim != 2 or array.dtype != np.float32 or not array.size:
        return {name: array}
    step = np.abs(array).max(axis=1, keepdims=True) / np.float32(MOST_STEPS)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.nan_to_num(np.rint(array / step)).clip(-MOST_STEPS, MOST_STEPS).astype(np.int8)
    return {name: steps, f"{name}.step": step} if np.array_equal(steps * step, array) else {name: array}
