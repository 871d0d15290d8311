"""The sway network of a garment model: on a body, and what is refused. In its file: test_model_file."""

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_avatar, random_model

from physkin_core import GarmentModelError
from physkin_core.model.sway_network import LARGEST_CODE, fold_body
from physkin_core.runtime.binding import bind_garment, encode_body


@pytest.fixture(scope="module")
def model():
    return random_model(np.random.default_rng(0), learnt_sway=True)


def test_other_skinning_weights_and_bodies_keep_it(model):
    assert model.for_engines().sway is not None
    assert replace(model, sway=None).arrays().keys() == {k for k in model.arrays() if not k.startswith("sway.")}


def test_a_body_is_a_code_folded_into_biases(model):
    avatar = random_avatar(np.random.default_rng(1), model.rig)
    network, code = model.sway, model.sway.body_code(encode_body(model, avatar))
    bound = bind_garment(model, avatar)
    assert code.shape == (3,) and np.abs(code).max() > 0.01
    np.testing.assert_allclose(
        bound.sway_layers[0][1], network.first[1] + network.first_code @ code, rtol=1e-4, atol=1e-5
    )
    np.testing.assert_allclose(
        bound.sway_layers[2][1], network.read[1] + network.read_code @ code, rtol=1e-4, atol=1e-5
    )
    far = network.code_mean + 1e4 * network.code_directions.sum(axis=0)
    assert np.abs(network.body_code(far)).max() == LARGEST_CODE
    assert fold_body(network, far)["sway_layers"][1][0].shape == (30, 13)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"joints": np.array([0, 1, 2, 7])}, r"sway.joints holds index 0..7, allowed 0..6"),
        ({"joints": np.arange(4.0)}, "sway.joints is of type float64"),
        ({"joints": np.arange(3)}, r"sway.first.weight has shape \(13, 23\), expected \(13, 21\)"),
        ({"rates": np.zeros(10, np.float32)}, "sway.rates holds 0, allowed: more than 0"),
        ({"turns": np.full(10, np.nan, np.float32)}, "sway.turns holds a value that is not finite"),
        ({"turns": np.zeros(9, np.float32)}, r"sway.turns has shape \(9,\), expected \(10,\)"),
        ({"first_code": np.zeros((13, 2), np.float32)}, r"sway.first.code has shape \(13, 2\), expected \(13, 3\)"),
        ({"code_mean": np.zeros(5, np.float32)}, r"sway.code.mean has shape \(5,\), expected \(64,\)"),
        ({"out": (np.zeros((90, 11), np.float32), np.zeros(90, np.float32))}, r"sway.out.weight has shape \(90, 11\)"),
    ],
)
def test_what_does_not_fit_is_refused(model, change, said):
    with pytest.raises(GarmentModelError, match=said):
        replace(model, sway=replace(model.sway, **change))
