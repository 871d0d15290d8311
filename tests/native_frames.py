"""The native evaluators as tests call them, and the rows that they read: the one place that knows how they are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from reference.frame_input import FrameInput

from physkin_core.outfit.outfit_evaluators import NativeOutfitEvaluator
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.native_evaluator import NativeEvaluator
from physkin_core.runtime.native_skinner import NativeSkinner
from physkin_core.sway.pace import FrameClock
from physkin_core.sway.sway import Sway

__all__ = ["NativeFrame", "NativeFrameInput", "NativeLayerOrder", "clouds", "native_skinner", "told"]


def told(gravity=(0.0, 0.0, -1.0), **numbers) -> np.ndarray:
    """A row (14,) float32 of `FrameInput`: effective gravity, and what else is told; nothing by default."""
    return FrameInput(np.asarray(gravity), **numbers).row()


class NativeFrame:
    """One to four bound garments as the native code drapes them, called as `ReferenceFrame` is; network weights in fp32
    unless told otherwise. options: instruction_set, precision, normals."""

    def __init__(self, bounds: Sequence[BoundGarment], orders=(), *, precision: str | None = "fp32", **options) -> None:
        self._alone, options = len(bounds) == 1 and not orders, options | {"precision": precision}
        self._evaluator = (
            NativeEvaluator(bounds[0], **options)
            if self._alone
            else NativeOutfitEvaluator(bounds, list(orders), **options)
        )
        self.instruction_set, self.precision = self._evaluator.instruction_set, self._evaluator.precision

    def evaluate(self, joint_positions: np.ndarray, rows: np.ndarray, outs: Sequence[np.ndarray]) -> None:
        self.bind_frame(joint_positions, rows, outs).step()

    def bind_frame(self, joint_positions: np.ndarray, rows: np.ndarray, outs: Sequence[np.ndarray]):
        """What has a method `step`: a frame of what the arrays hold then."""
        if self._alone:
            return self._evaluator.bind_step(joint_positions, rows[0], outs[0])
        return self._evaluator.bind_step(joint_positions, rows, outs)

    def node_transforms(self, garment: int = 0) -> np.ndarray:
        return self._evaluator.node_transforms() if self._alone else self._evaluator.node_transforms(garment)

    def corrections(self) -> np.ndarray:
        """(12 m,) of a single garment, in the last frame."""
        return self._evaluator.corrections().reshape(-1)


def native_skinner(garment: BoundGarment) -> NativeSkinner:
    """What skins a garment from garment nodes that somebody else computed."""
    arrays = garment.vertices, garment.normals, garment.node_rest, garment.influence_nodes, garment.influence_weights
    return NativeSkinner(*arrays)


def clouds(frame, bounds: Sequence[BoundGarment], joint_positions: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """What a `NativeFrame` or a `ReferenceFrame` of bounds makes of a frame: (n, 6) of each. rows: one a garment, or
    one for all."""
    outs = [np.full((len(bound.vertices), 6), np.nan, dtype=np.float32) for bound in bounds]
    frame.evaluate(joint_positions, np.stack(rows * (len(bounds) // len(rows))), outs)
    return outs


class NativeFrameInput:
    """From time and root to rows, as `ReferenceFrameInput`."""

    def __init__(self, settings, learnt: Sequence[bool]) -> None:
        self._sway, self._clock, self._learnt = Sway(settings=settings), FrameClock(), learnt

    def rows(self, time: float, root: np.ndarray, amounts: Sequence[float]) -> np.ndarray:
        passed, rows = self._clock.passed(time), []
        for amount, learnt in zip(amounts, self._learnt):
            asked = {"amount": amount, "learnt": learnt}
            down, felt, twist = self._sway.gravity(time, root, None, accelerated=True, **asked)
            moment = self._sway.moment(passed, self._clock.elapsed, twist=twist, rooted=True, **asked)
            rows.append(moment.after(down if felt is None else felt / 9.81))
        return np.stack(rows)


class NativeLayerOrder:
    """The native order of two layers, apart from any garment, called as the reference's `LayerOrder` is."""

    def __init__(self, order) -> None:
        self._order, self._step = order, None

    def apply(self, steady: np.ndarray, yielding: np.ndarray, *, look_at_all: bool) -> None:
        """Move yielding (n, 6) float32. The first call looks at all, whatever it is told; later ones must not."""
        layers = [steady, yielding] if self._order.steady < self._order.yielding else [yielding, steady]
        if self._step is None:
            order = replace(self._order, steady=layers[0] is not steady, yielding=layers[0] is steady)
            self._rows = [layer.copy() for layer in layers]
            evaluator = NativeOutfitEvaluator([_standing(layer) for layer in layers], [order])
            inputs = np.empty(0, dtype=np.float32), np.float32([0, 0, -1])
            self._step = evaluator.bind_step(*inputs, self._rows)
            self._step.step()
        else:
            assert not look_at_all
            for row, layer in zip(self._rows, layers):
                row[:] = layer
            self._step.keep()
        yielding[:, :3] = self._rows[layers[0] is steady][:, :3]


def _standing(cloth: np.ndarray) -> BoundGarment:
    """A bound garment that is cloth (n, 6) as it lies, in every frame: one bone, one garment node, no corrections."""
    zeros = lambda *shape: np.zeros(shape, dtype=np.float32)  # noqa: E731
    return BoundGarment(
        bone_parents=np.int32([-1]),
        bone_heads=zeros(1, 3),
        dof_bone=np.empty(0, dtype=np.int32),
        dof_axis=zeros(0, 3),
        **{name: zeros(0) for name in ("dof_rest", "dof_lower", "dof_upper")},
        pose_layers=((zeros(2, 3), zeros(2)),),
        deformer_bones=np.int32([0]),
        deformer_layers=((zeros(1, 12), zeros(1)), (zeros(12, 1), zeros(12))),
        node_bone=np.int32([0]),
        node_positions=zeros(1, 3),
        node_rest=zeros(1, 3),
        vertices=np.ascontiguousarray(cloth[:, :3]),
        normals=np.ascontiguousarray(cloth[:, 3:]),
        influence_nodes=np.zeros((len(cloth), 1), dtype=np.int32),
        influence_weights=np.ones((len(cloth), 1), dtype=np.float32),
    )
