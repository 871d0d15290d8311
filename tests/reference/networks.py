"""Pose modulator and node deformer: multi-layer perceptrons with feature-wise modulation (paper: the same names)."""

import numpy as np


def silu(x):
    with np.errstate(over="ignore"):  # exp(-x) may be infinite, which gives the right 0
        return x / (1 + np.exp(-x))


def linear(layer, x):
    weight, bias = layer
    return weight.astype(np.float64) @ x + bias


def mlp(layers, x, modulation=None):
    """Hidden layers silu((1 + scale) (W x + bias) + shift), or W x where the bias is empty; the last one linear.

    modulation: [scale_0, shift_0, scale_1, ...] of all hidden layers, or None for zeros.
    """
    return linear(layers[-1], last_hidden(layers, x, modulation))


def last_hidden(layers, x, modulation=None):
    """What the last layer of such a network reads."""
    *hidden, _ = layers
    start = 0
    for layer in hidden:
        if len(layer[0]) and not len(layer[1]):
            x = layer[0].astype(np.float64) @ x
            continue
        x = linear(layer, x)
        if modulation is not None:
            scale, shift = np.split(modulation[start : start + 2 * len(x)], 2)
            x = (1 + scale) * x + shift
            start += 2 * len(x)
        x = silu(x)
    return x
