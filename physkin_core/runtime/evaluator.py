"""What evaluates a bound garment: the native evaluator or the readable reference, as asked for."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["Evaluator", "make_evaluator"]


class Evaluator(Protocol):
    """Both kinds; see `ReferenceEvaluator.evaluate`."""

    def evaluate(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> None: ...


def make_evaluator(backend: str, bound: BoundGarment, *, precision: str | None = None, normals: str = "skinned"):
    """Of backend "native", with `precision` as `NativeEvaluator` takes it, or "numpy". Raises what either raises."""
    if backend == "native":
        from physkin_core.runtime.native_evaluator import NativeEvaluator

        return NativeEvaluator(bound, precision=precision, normals=normals)
    from physkin_core.runtime.reference_evaluator import ReferenceEvaluator

    return ReferenceEvaluator(bound, normals=normals)
