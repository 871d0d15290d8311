"""A frame of an outfit: in C++, and its NumPy reference. Layers are given innermost first.

Dimensions: `d` degrees of freedom, `n` vertices of a layer that are computed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from physkin_core.outfit.layer_order import LayerOrder, ReferenceLayerOrder
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.native_evaluator import _native
from physkin_core.runtime.reference_evaluator import ReferenceEvaluator
from physkin_core.sway.moment import GRAVITY_SIZES

__all__ = ["NativeOutfitEvaluator", "ReferenceOutfitEvaluator"]


class NativeOutfitEvaluator:
    """Evaluates bound garments of one body together. Not for use by two threads at once.

    bounds, orders: the layers, and what keeps them in order. instruction_set, precision, normals: as in
    `NativeEvaluator`. Raises ValueError as that does, for garments of several rigs or bodies, or where an index of an
    order is out of range.
    """

    def __init__(
        self,
        bounds: Sequence[BoundGarment],
        orders: Sequence[LayerOrder],
        *,
        instruction_set: str | None = None,
        precision: str | None = None,
        normals: Literal["skinned", "faces"] = "skinned",
    ) -> None:
        self._outfit = _native.Outfit(list(bounds), list(orders), instruction_set, precision, normals)

    @property
    def instruction_set(self) -> str:
        """Name of the instruction set in use."""
        return self._outfit.instruction_set

    @property
    def precision(self) -> str:
        """Precision of the network weights."""
        return self._outfit.precision

    def evaluate(self, joint_positions: np.ndarray, gravity: np.ndarray, outs: Sequence[np.ndarray]) -> None:
        """Compute one frame. joint_positions: (d,) [rad]. gravity: (3,), or (layers, 3), one each, or with the
        moment behind, as of `physkin_core.sway.moment`. outs: one a layer, writable float32, all (n, 6) for x, y, z [m]
        and normals, or all (n, 3); any row stride.

        Raises TypeError for another dtype; ValueError for a wrong shape or where a value is not finite (nothing is
        written then).
        """
        try:
            self._outfit.evaluate(joint_positions, gravity, list(outs))
        except TypeError:
            raise TypeError(_wrong_arrays(outs)) from None

    def node_transforms(self, garment: int) -> np.ndarray:
        """Garment node transforms (m, 3, 4) of a garment in the last frame; a view that the next frame overwrites."""
        return self._outfit.node_transforms(garment)

    def bind_step(
        self, joint_positions: np.ndarray, gravity: np.ndarray, outs: Sequence[np.ndarray]
    ) -> _native.OutfitStep:
        """A frame bound to its arrays, C-contiguous float32 that are changed in place: `step()` allocates nothing.
        `skin()` and `keep()` repeat the last frame's skinning, and the order of layers, for timing.

        Raises TypeError and ValueError as `evaluate` does.
        """
        try:
            return _native.OutfitStep(self._outfit, joint_positions, gravity, list(outs))
        except TypeError:
            raise TypeError(_wrong_arrays(outs)) from None


class ReferenceOutfitEvaluator:
    """The same in NumPy, slowly. Arguments as of `NativeOutfitEvaluator`."""

    instruction_set = "numpy"
    precision = "fp32"

    def __init__(
        self,
        bounds: Sequence[BoundGarment],
        orders: Sequence[LayerOrder],
        *,
        normals: Literal["skinned", "faces"] = "skinned",
    ) -> None:
        from physkin_core.model.garment import vertex_normals

        self._bounds = list(bounds)
        self._evaluators = [ReferenceEvaluator(bound) for bound in bounds]
        self._orders = [(order.steady, order.yielding, ReferenceLayerOrder(order)) for order in orders]
        self._jumped = True  # since layers were last put in order
        self._face_normals = vertex_normals if normals == "faces" else None

    def node_transforms(self, garment: int) -> np.ndarray:
        """As `NativeOutfitEvaluator.node_transforms`."""
        return self._evaluators[garment].node_transforms()

    def evaluate(self, joint_positions: np.ndarray, gravity: np.ndarray, outs: Sequence[np.ndarray]) -> None:
        """As `NativeOutfitEvaluator.evaluate`."""
        if len(outs) != len(self._bounds):
            raise ValueError(f"out has {len(outs)} arrays; expected one for each of {len(self._bounds)} garments")
        layers = [np.empty((len(bound.vertices), 6), dtype=np.float32) for bound in self._bounds]
        shape, size = np.shape(gravity), np.shape(gravity)[-1:]
        if shape not in (size, (len(layers), *size)) or size not in {(size,) for size in GRAVITY_SIZES}:
            allowed = ", ".join(f"({size},), {(len(layers), size)}" for size in GRAVITY_SIZES)
            raise ValueError(f"gravity must have one of the shapes {allowed}, got {np.shape(gravity)}")
        gravities = np.broadcast_to(gravity, (len(layers), *size))
        for evaluator, down, layer in zip(self._evaluators, gravities, layers):
            evaluator.evaluate(joint_positions, down, layer)
            self._jumped |= evaluator.jumped
        jumped, self._jumped = self._jumped, False
        for k in range(len(layers)):
            for steady, yielding, order in self._orders:
                if max(steady, yielding) == k:
                    order.apply(layers[steady], layers[yielding], look_at_all=jumped)
        for bound, layer, out in zip(self._bounds, layers, outs):
            if self._face_normals is not None:
                layer[:, 3:] = self._face_normals(layer[:, :3], bound.faces)
            out[:] = layer[:, : out.shape[1]]


def _wrong_arrays(outs: Sequence[np.ndarray]) -> str:
    got = [f"{getattr(out, 'dtype', type(out).__name__)} of shape {getattr(out, 'shape', None)}" for out in outs]
    return f"arrays must be NumPy float32 (inputs also float64) and outs writable and 2-D; outs are {', '.join(got)}"
