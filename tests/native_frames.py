"""The native evaluators as tests call them, and the rows that they read: the one place that knows how they are made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from reference.frame_input import FrameInput as ReferenceRow

from physkin_core.native_module import native
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Evaluator
from physkin_core.runtime.frame_input import FrameInput

__all__ = ["NativeFrame", "NativeFrameInput", "NativeLayerOrder", "clouds", "told"]


def told(gravity=(0.0, 0.0, -1.0), **numbers) -> np.ndarray:
    """A row (13,) float32: effective gravity, and what else is told; nothing by default."""
    return ReferenceRow(np.asarray(gravity), **numbers).row()


class NativeFrame(Evaluator):
    """The native evaluator, called as `ReferenceFrame` is; network weights in fp32 unless asked otherwise."""

    def __init__(self, bounds: Sequence[BoundGarment], orders=(), *, precision: str | None = "fp32", **options) -> None:
        super().__init__(bounds, orders, precision=precision, **options)

    def corrections(self, garment: int = 0) -> np.ndarray:
        """(12 m,), in the last frame."""
        return super().corrections(garment).reshape(-1)


def clouds(frame, bounds: Sequence[BoundGarment], joint_positions: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """What a `NativeFrame` or a `ReferenceFrame` of bounds makes of a frame: (n, 6) of each. rows: one a garment, or
    one for all."""
    outs = [np.full((len(bound.vertices), 6), np.nan, dtype=np.float32) for bound in bounds]
    frame.evaluate(joint_positions, np.stack(rows * (len(bounds) // len(rows))), outs)
    return outs


class NativeFrameInput:
    """From time, root and wind to rows, as `ReferenceFrameInput`."""

    def __init__(self, garments: int) -> None:
        self.frame_input = FrameInput(garments)

    def rows(self, time: float, root: np.ndarray, amounts: Sequence[float], wind=(0.0, 0.0, 0.0)) -> np.ndarray:
        self.frame_input.sway, self.frame_input.wind = amounts, wind
        self.frame_input.fill(time=time, root=root)
        return self.frame_input.rows.copy()


class NativeLayerOrder:
    """The native order of two layers, called as the reference's `LayerOrder` is."""

    def __init__(self, order) -> None:
        self._binding, self._order = order, None

    def apply(self, steady: np.ndarray, yielding: np.ndarray, *, look_at_all: bool, passed: float = -1.0) -> None:
        """Move yielding (n, 6) float32."""
        if self._order is None:
            self._order = native.LayerOrder(self._binding, len(steady), len(yielding))
        self._order.apply(steady, yielding, look_at_all, passed)
