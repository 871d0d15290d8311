"""Modulated networks, neuron by neuron; folding a constant modulation or a body's garment nodes changes nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from random_models import random_layers, random_model, random_rotation

from physkin_core.model.garment_nodes import pose_nodes
from physkin_core.model.mlp import ACTIVATIONS, fold_modulation, modulated_mlp, modulation_size, split_modulation
from physkin_core.model.node_deformer import fold_first_layer, node_corrections
from physkin_core.model.pose_modulator import pose_modulation

SIZES = (5, 7, 4, 6, 3)


def neuron_by_neuron(layers, x, modulation, activation):
    """Plain Python: act((1 + scale) * (w . x + b) + shift), modulation [scale_0, shift_0, scale_1, ...]."""
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
            values.append(max(y, 0.0) if activation == "relu" else y / (1 + math.exp(-y)))


@pytest.mark.parametrize("activation", ["silu", "relu"])
def test_values_neuron_by_neuron(activation):
    rng = np.random.default_rng(0)
    layers = random_layers(rng, SIZES, output_scale=1)
    modulation, x = rng.normal(size=(2, modulation_size(layers))), rng.normal(size=(2, SIZES[0]))
    result = modulated_mlp(layers, x, modulation, activation)
    for sample in range(2):
        expected = neuron_by_neuron(layers, x[sample], modulation[sample], activation)
        np.testing.assert_allclose(result[sample], expected, rtol=1e-6)
    np.testing.assert_allclose(pose_modulation(layers, x, modulation, activation), result)


def test_modulation_counts_scale_and_shift_of_hidden_units():
    layers = random_layers(np.random.default_rng(1), SIZES, output_scale=1)
    assert modulation_size(layers) == 2 * (7 + 4 + 6)
    assert modulation_size(layers[-1:]) == 0
    numbered = np.arange(34)
    (scale, shift), (_, second_shift), _ = split_modulation(layers, numbered)
    assert scale.tolist() == list(range(7)) and shift.tolist() == list(range(7, 14))
    assert second_shift.tolist() == [18, 19, 20, 21]


@pytest.mark.parametrize("activation", ["silu", "relu"])
def test_folded_modulation_is_the_same_network(activation):
    rng = np.random.default_rng(2)
    layers = random_layers(rng, SIZES, output_scale=1)
    modulation, x = rng.normal(size=modulation_size(layers)), rng.normal(size=SIZES[0])
    folded = fold_modulation(layers, modulation)
    plain = modulated_mlp(folded, x, np.zeros(modulation_size(layers)), activation)
    np.testing.assert_allclose(plain, neuron_by_neuron(layers, x, modulation, activation), rtol=1e-5)


def test_activations_far_out():
    """No overflow warnings, and the right limits."""
    x = np.array([-1e4, -90.0, -1.0, 0.0, 1.0, 90.0, 1e4], dtype=np.float32)
    with np.errstate(all="raise", under="ignore"):
        silu, relu = ACTIVATIONS["silu"](x), ACTIVATIONS["relu"](x)
    expected = [0, 0, -1 / (1 + math.e), 0, 1 / (1 + math.exp(-1)), 90, 1e4]
    np.testing.assert_allclose(silu, expected, rtol=1e-6, atol=1e-25)
    np.testing.assert_array_equal(relu, np.maximum(x, 0))


@pytest.mark.parametrize("node_outputs", [9, 12])
def test_first_layer_folds_onto_bones(node_outputs):
    """Node transforms in, or only the bones that garment nodes follow: the same correctives, on any body."""
    rng = np.random.default_rng([3, node_outputs])
    model = random_model(rng, bones=9, nodes=14, node_outputs=node_outputs)
    transforms = np.array([np.c_[random_rotation(rng), rng.normal(size=3)] for _ in range(9)])
    positions = rng.normal(size=(14, 3))
    modulation = rng.normal(size=modulation_size(model.node_deformer))
    nodes = pose_nodes(transforms, model.node_bone, positions)
    expected = node_corrections(model.node_deformer, nodes, modulation, "silu")
    assert expected.shape == (14 * node_outputs,)
    (weight, bias), *rest = model.node_deformer
    used, folded = fold_first_layer(weight, model.node_bone, positions)
    assert used.tolist() == sorted(set(model.node_bone.tolist())) and folded.shape == (len(weight), 12 * len(used))
    seen = transforms[used].reshape(-1)
    np.testing.assert_allclose(modulated_mlp([(folded, bias), *rest], seen, modulation, "silu"), expected, atol=1e-6)
