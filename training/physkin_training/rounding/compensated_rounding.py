"""Network weights on few steps, what each loses made up for by those after it (GPTQ, Frantar et al. 2023).

The native evaluator computes in eight bits with a scale a row, and a deflated file takes the fewer bits the fewer steps
there are. Rounded one by one, network weights would move vertices by centimetres. Inputs of a layer hang together, so
that other network weights of a row can take over what rounding one of them adds. What is stored is on the evaluator's
own steps, so that it rounds nothing again.

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
"""Columns whose losses are handed on together to those after them."""


@dataclass(frozen=True)
class Rounding:
    """How finely a layer is rounded. every: to multiples of so many steps, but for the largest. alike: outputs are in
    one unit, and rounded to the same absolute size, that of a row with the root mean square of all largest; else each
    by its own. four: the columns of a transform have a scale each. damping: of the inputs' mean square, added to each,
    so that what frames do not tell stays as it was."""

    every: int
    alike: bool = False
    four: bool = False
    damping: float = 0.02

    def at(self, every: int | None) -> Rounding:
        """The same at so many steps, None for its own."""
        return self if every is None else replace(self, every=every)


def compensated_rounding(weight: np.ndarray, square: np.ndarray, rounding: Rounding) -> np.ndarray:
    """A network weight (o, k) in whole steps of its row, close to it over inputs of which the mean of products is
    `square` (k, k): (o, k) float32.

    Column by column, the strongest inputs first; the largest of a row stays, for it tells the size of its steps.
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
    """Of the inputs whose mean of products is `square` (k, k). 1 where all are 0, as those of a layer that training has
    put to sleep are (every ReLU before it below 0): its network weights are then rounded one by one."""
    return float(np.trace(square)) / len(square) or 1.0


def _every(step: np.ndarray, rounding: Rounding) -> np.ndarray:
    """Multiples of how many of their steps (o, scales) rows are rounded to."""
    if not rounding.alike:
        return np.full(step.shape, rounding.every)
    same = rounding.every * np.sqrt(np.mean(step**2))
    return np.clip(np.rint(same / step), 1, MOST_STEPS_IN_8_BITS).astype(int)
