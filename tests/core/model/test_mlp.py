"""What layers read, which network weights are rounded over, against the reference."""

import numpy as np
from random_models import random_layers
from reference.networks import mlp

from physkin_core.model.mlp import fold_modulation, layer_inputs, modulation_over, modulation_size


def test_the_last_is_what_the_network_gives():
    """Under a modulation, or with it folded in; of several inputs at once."""
    rng = np.random.default_rng(0)
    layers = random_layers(rng, (5, 7, 4, 6, 3), output_scale=1)
    modulation, x = rng.normal(size=modulation_size(layers)), rng.normal(size=(2, 5))
    expected = [mlp(layers, each, modulation) for each in x]
    np.testing.assert_allclose(layer_inputs(layers, x, modulation)[-1], expected, rtol=1e-6)
    folded = layer_inputs(fold_modulation(layers, modulation), x, None)
    np.testing.assert_allclose(folded[-1], expected, rtol=1e-6)
    assert [each.shape[1] for each in folded] == [5, 7, 4, 6, 3]


def test_another_modulation_over_the_one_that_is_folded_in():
    rng = np.random.default_rng(1)
    layers = random_layers(rng, (5, 7, 4, 3), output_scale=1)
    folded, other = rng.normal(size=(2, modulation_size(layers)))
    x = rng.normal(size=(2, 5))
    found = layer_inputs(fold_modulation(layers, folded), x, modulation_over(layers, folded, other))[-1]
    np.testing.assert_allclose(found, layer_inputs(layers, x, other)[-1], rtol=1e-5, atol=1e-6)
