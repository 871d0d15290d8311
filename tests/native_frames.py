"""The native evaluators as tests call them, and the rows that they read: the one place that knows how they are made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from reference.frame_input import FrameInput

from physkin_core.native_module import native
from physkin_core.runtime import evaluator
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Skinner as native_skinner
from physkin_core.sway import frame_input

__all__ = ["NativeFrame", "NativeFrameInput", "NativeLayerOrder", "clouds", "native_skinner", "told"]


def told(gravity=(0.0, 0.0, -1.0), **numbers) -> np.ndarray:
    """A row (14,) float32 of `FrameInput`: effective gravity, and what else is told; nothing by default."""
    return FrameInput(np.asarray(gravity), **numbers).row()


class NativeFrame(evaluator.Evaluator):
    """With network weights in fp32, unless told otherwise."""

    def __init__(self, bounds: Sequence[BoundGarment], orders=(), *, precision: str | None = "fp32", **options) -> None:
        super().__init__(bounds, orders, precision=precision, **options)

    def corrections(self, garment: int = 0) -> np.ndarray:
        """(12 m,)."""
        return super().corrections(garment).reshape(-1)


def clouds(frame, bounds: Sequence[BoundGarment], joint_positions: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """What a `NativeFrame` or a `ReferenceFrame` of bounds makes of a frame: (n, 6) of each. rows: one a garment, or
    one for all."""
    outs = [np.full((len(bound.vertices), 6), np.nan, dtype=np.float32) for bound in bounds]
    frame.evaluate(joint_positions, np.stack(rows * (len(bounds) // len(rows))), outs)
    return outs


class NativeFrameInput:
    """From time and root to rows, as `ReferenceFrameInput`."""

    def __init__(self, learnt: Sequence[bool]) -> None:
        self._input = frame_input.FrameInput(learnt)

    def rows(self, time: float, root: np.ndarray, amounts: Sequence[float]) -> np.ndarray:
        self._input.sways = amounts
        self._input.fill(time=time, root=root)
        return self._input.rows.copy()


class NativeLayerOrder:
    """The native order of two layers, called as the reference's `LayerOrder` is."""

    def __init__(self, order) -> None:
        self._order, self._native = order, None

    def apply(self, steady: np.ndarray, yielding: np.ndarray, *, look_at_all: bool) -> None:
        first = self._native is None
        if first:
            self._native = native.LayerOrder(self._order, len(steady), len(yielding))
        self.native.apply(steady, yielding, look_at_all=look_at_all or first)
