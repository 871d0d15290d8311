"""The bound garment file: one garment on one body for hosts without Python, read by native/include/physkin.h.

A safetensors file of the arrays of `BoundGarment` (layers as `pose_layers.0.weight`, ...) in float32 and int32 as
the evaluator takes them, so that a host computes the same bits, sealed by a digest. Fitting the rig, the canonical pose
and the encoding of the body are done by then.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from physkin_core.native_module import native
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.tensor_file import write_tensors

__all__ = ["BOUND_SCHEMA_VERSION", "save_bound_garment"]

FORMAT = "physkin-bound-garment"
BOUND_SCHEMA_VERSION: str = native.constants["bound_garment_version"]


def save_bound_garment(bound: BoundGarment, path: str | Path, *, name: str, joint_names: Sequence[str]) -> None:
    """Write a bound garment to `path`, replacing what is there in one step.

    joint_names: (d,) in the order of the joint positions. Raises ValueError when there is not one name a degree of
    freedom.
    """
    if len(joint_names) != len(bound.dof_bone):
        raise ValueError(f"{len(joint_names)} joint names for {len(bound.dof_bone)} degrees of freedom")
    tensors = {}
    for field, kind, _ in native.bound_garment_fields():
        value = getattr(bound, field)
        if kind != "layers":
            tensors[field] = value
            continue
        for index, (weight, bias) in enumerate(value):
            tensors[f"{field}.{index}.weight"], tensors[f"{field}.{index}.bias"] = weight, bias
    metadata = {
        "format": FORMAT,
        "schema_version": BOUND_SCHEMA_VERSION,
        "name": name,
        "joint_names": json.dumps(list(joint_names)),
    }
    write_tensors(Path(path), metadata, tensors)
