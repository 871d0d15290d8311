"""Modulations folded into the layers of a network, against the reference."""

import numpy as np
import pytest
from random_models import random_layers
from reference.networks import mlp

from physkin_core.model.mlp import fold_modulation, modulation_over, modulation_size

LAYERS = random_layers(np.random.default_rng(0), (5, 7, 4, 6, 3), output_scale=1)
PROJECTION = np.random.default_rng(4).normal(size=(4, 4)).astype(np.float32), np.empty(0, dtype=np.float32)
LAYERS = (*LAYERS[:2], PROJECTION, *LAYERS[2:])


@pytest.fixture
def modulations():
    return np.random.default_rng(1).normal(size=(2, modulation_size(LAYERS)))


def test_a_modulation_folded_in_is_the_modulation(modulations):
    x = np.random.default_rng(2).normal(size=5)
    found = mlp(fold_modulation(LAYERS, modulations[0]), x)
    np.testing.assert_allclose(found, mlp(LAYERS, x, modulations[0]), rtol=1e-6)


def test_another_modulation_over_the_one_that_is_folded_in(modulations):
    folded, other = modulations
    x = np.random.default_rng(2).normal(size=5)
    found = mlp(fold_modulation(LAYERS, folded), x, modulation_over(LAYERS, folded, other))
    np.testing.assert_allclose(found, mlp(LAYERS, x, other), rtol=1e-5, atol=1e-6)
