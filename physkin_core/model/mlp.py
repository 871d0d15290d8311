"""Multi-layer perceptrons with feature-wise modulation: the shared shape of pose modulator and node deformer.

Modulation comes before the activation, as scale and shift: x = silu((1 + scale) * (W x + bias) + shift). With the
modulation constant for a body it folds into the layer (`fold_modulation`). A projection, without bias, modulation and
activation, makes the layer after it one of low rank.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from physkin_core.native_module import as_float32

__all__ = [
    "Layer",
    "float32_layers",
    "fold_modulation",
    "modulation_over",
    "modulation_size",
    "silu",
    "split_modulation",
]

Layer = tuple[np.ndarray, np.ndarray]
"""Network weight (out, in) and bias (out,); of a projection, which has neither modulation nor activation, (0,)."""


def float32_layers(layers: Iterable[Layer]) -> tuple[Layer, ...]:
    """Layers as the native code takes them."""
    return tuple((as_float32(weight), as_float32(bias)) for weight, bias in layers)


def silu(x: np.ndarray) -> np.ndarray:
    """The activation: x / (1 + exp(-x))."""
    return x / (1 + np.exp(-np.clip(x, -80, None)))


def modulation_size(layers: Sequence[Layer]) -> int:
    """Length of the modulation of a network: scale and shift for every hidden unit."""
    return 2 * sum(len(bias) for _, bias in layers[:-1])


def split_modulation(layers: Sequence[Layer], modulation: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cut a modulation (..., size) laid out [scale_0, shift_0, scale_1, ...] into (scale, shift) a hidden layer."""
    parts, start = [], 0
    for _, bias in layers[:-1]:
        width = len(bias)
        parts.append((modulation[..., start : start + width], modulation[..., start + width : start + 2 * width]))
        start += 2 * width
    return parts


def fold_modulation(layers: Sequence[Layer], modulation: np.ndarray) -> tuple[Layer, ...]:
    """The plain network equal to `layers` under a constant modulation (size,)."""
    hidden = [
        ((1 + scale)[:, None] * weight, (1 + scale) * bias + shift) if len(bias) else (weight, bias)
        for (weight, bias), (scale, shift) in zip(layers[:-1], split_modulation(layers, modulation), strict=True)
    ]
    return (*hidden, layers[-1])


def modulation_over(layers: Sequence[Layer], folded: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The modulation (size,) of `layers` into which `folded` (size,) is folded that makes them those under `other`."""
    parts = []
    pairs = (split_modulation(layers, each.astype(np.float64)) for each in (folded, other))
    for (scale, shift), (other_scale, other_shift) in zip(*pairs):
        ratio = (1 + other_scale) / (1 + scale)
        parts += [ratio - 1, other_shift - ratio * shift]
    return np.concatenate([np.empty(0), *parts])
