"""Rounds network weights to few steps, each making up for what rounding the earlier ones changed (GPTQ, Frantar et al.
2023).

The native evaluator computes in eight bits with one scale a row, and a deflated file is the smaller the fewer steps
there are. Rounded one by one, network weights would move vertices by centimetres. But the inputs of a layer are
correlated, so that other network weights of a row can make up for what rounding one of them changes. The results lie on
the evaluator's own steps, so that it does not round them again.

Dimensions: `k` inputs of a layer, `o` its outputs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import nn

from physkin_core.formats.packed_weights import MOST_STEPS, MOST_STEPS_IN_8_BITS

__all__ = ["InputSquares", "Rounding", "compensated_rounding", "mean_square"]

AT_ONCE = 64
"""Columns whose losses are passed on together to the columns after them."""


@dataclass(frozen=True)
class Rounding:
    """How finely a layer is rounded.

    every: to multiples of so many steps of the row; its largest network weight stays exact. alike: all outputs have the
    same unit, so all rows are rounded to multiples of the same size, `every` root mean square steps. four: each column
    of a transform has a scale of its own. damping: this share of the inputs' mean square is added to every input's, so
    that network weights on which the frames have no influence stay as they were.
    """

    every: int
    alike: bool = False
    four: bool = False
    damping: float = 0.02

    def at(self, every: int | None) -> Rounding:
        """The same with multiples of so many steps; None leaves it as it is."""
        return self if every is None else replace(self, every=every)


def compensated_rounding(weight: np.ndarray, square: np.ndarray, rounding: Rounding) -> np.ndarray:
    """Network weights (o, k) float32 in whole steps of their row, with outputs close to those of `weight` (o, k).

    square: (k, k), mean of products of the layer's inputs. Columns are rounded one after the other, the strongest
    inputs first. The largest of a row stays, because it defines the size of the steps.
    """
    inputs = len(square)
    order = np.argsort(-np.diag(square), kind="stable")
    damped = square[np.ix_(order, order)] + rounding.damping * mean_square(square) * np.eye(inputs)
    takes_over = np.linalg.cholesky(np.linalg.inv(damped)).T
    scales, most_steps = (4, MOST_STEPS) if rounding.four else (1, MOST_STEPS_IN_8_BITS)
    scale, left = order % scales, weight[:, order].astype(np.float64)
    size = np.abs(left)[:, :, None] * (scale[:, None] == np.arange(scales))
    largest = size.argmax(axis=1)
    step = np.maximum(size.max(axis=1).astype(np.float16), np.float16(1e-7)).astype(np.float64) / most_steps
    every = _every(step, rounding)
    sign, rounded = np.sign(left), np.empty_like(left)
    for start in range(0, inputs, AT_ONCE):
        together = slice(start, min(start + AT_ONCE, inputs))
        lost = np.empty((len(left), together.stop - start))
        for column in range(start, together.stop):
            own, times = step[:, scale[column]], every[:, scale[column]]
            whole = times * np.clip(
                np.rint(left[:, column] / (times * own)), -(most_steps // times), most_steps // times
            )
            whole = np.where(largest[:, scale[column]] == column, sign[:, column] * most_steps, whole)
            rounded[:, column] = whole * own
            lost[:, column - start] = (left[:, column] - rounded[:, column]) / takes_over[column, column]
            left[:, column : together.stop] -= (
                lost[:, column - start, None] * takes_over[column, column : together.stop]
            )
        left[:, together.stop :] -= lost @ takes_over[together, together.stop :]
    return np.ascontiguousarray(rounded[:, np.argsort(order)], dtype=np.float32)


class InputSquares:
    """Means of products of what layers read, from here on, whenever their network is called. layers: by name."""

    def __init__(self, layers: dict[str, nn.Linear]) -> None:
        self._sums = dict.fromkeys(layers, (0, 0))
        for name, layer in layers.items():
            layer.register_forward_hook(lambda _, inputs, __, name=name: self._add(name, inputs[0]))

    def _add(self, name: str, x: torch.Tensor) -> None:
        x = x.detach().flatten(0, -2).double()
        total, count = self._sums[name]
        self._sums[name] = total + x.T @ x, count + len(x)

    def means(self) -> dict[str, np.ndarray]:
        """(k, k) float64 by the name of the layer, once all have been called."""
        return {name: (total / count).cpu().numpy() for name, (total, count) in self._sums.items()}


def mean_square(square: np.ndarray) -> float:
    """Mean square of the inputs whose mean of products is `square` (k, k). 1 where all are 0, as in a layer that
    training has put to sleep: its network weights are then rounded one by one."""
    return float(np.trace(square)) / len(square) or 1.0


def _every(step: np.ndarray, rounding: Rounding) -> np.ndarray:
    """Multiples of how many of their steps (o, scales) rows are rounded to."""
    if not rounding.alike:
        return np.full(step.shape, rounding.every)
    same = rounding.every * np.sqrt(np.mean(step**2))
    return np.clip(np.rint(same / step), 1, MOST_STEPS_IN_8_BITS).astype(int)
