"""Modulated networks, neuron by neuron. Folding has its test where a frame is compared with the unfolded chain."""

from __future__ import annotations

import math

import numpy as np
from random_models import random_layers

from physkin_core.model.mlp import modulated_mlp, modulation_size, silu
from physkin_core.model.pose_modulator import pose_modulation

SIZES = (5, 7, 4, 6, 3)


def neuron_by_neuron(layers, x, modulation):
    """Plain Python: silu((1 + scale) * (w . x + b) + shift), modulation [scale_0, shift_0, scale_1, ...]."""
    at = 0
    values = [float(v) for v in x]
    for index, (weight, bias) in enumerate(layers):
        summed = [sum(w * v for w, v in zip(row, values)) + b for row, b in zip(weight.tolist(), bias.tolist())]
        if index == len(layers) - 1:
            return summed
        width = len(summed)
        scale, shift = modulation[at : at + width], modulation[at + width : at + 2 * width]
        at += 2 * width
        values = []
        for s, scale_k, shift_k in zip(summed, scale, shift):
            y = (1 + scale_k) * s + shift_k
            values.append(y / (1 + math.exp(-y)))


def test_values_neuron_by_neuron():
    rng = np.random.default_rng(0)
    layers = random_layers(rng, SIZES, output_scale=1)
    modulation, x = rng.normal(size=(2, modulation_size(layers))), rng.normal(size=(2, SIZES[0]))
    result = modulated_mlp(layers, x, modulation)
    for sample in range(2):
        expected = neuron_by_neuron(layers, x[sample], modulation[sample])
        np.testing.assert_allclose(result[sample], expected, rtol=1e-6)
    np.testing.assert_allclose(pose_modulation(layers, x, modulation), result)


def test_the_activation_far_out():
    """No overflow warnings, and the right limits."""
    x = np.array([-1e4, -90.0, -1.0, 0.0, 1.0, 90.0, 1e4], dtype=np.float32)
    with np.errstate(all="raise", under="ignore"):
        far_out = silu(x)
    expected = [0, 0, -1 / (1 + math.e), 0, 1 / (1 + math.exp(-1)), 90, 1e4]
    np.testing.assert_allclose(far_out, expected, rtol=1e-6, atol=1e-25)
