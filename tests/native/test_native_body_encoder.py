"""The native body encoder against the reference, on every instruction set of this CPU."""

import numpy as np
import pytest
from random_models import random_avatar, random_hyper_modulator, random_model, unit_rows
from reference.hyper_modulator import body_modulation

from physkin_core import Draper
from physkin_core.model.hyper_modulator import POINT_COUNT
from physkin_core.model.mlp import fold_modulation
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.runtime.body_encoder import encode_points
from physkin_core.runtime.evaluator import supported_instruction_sets

pytestmark = pytest.mark.usefixtures("exact_network_weights")

SETS = supported_instruction_sets()
CASES = [  # points, token width, feed-forward width, residual blocks, outputs
    (1, 8, 16, 0, 1),
    (2, 12, 1, 1, 7),
    (63, 128, 256, 2, 300),
    (64, 20, 33, 3, 5),
    (65, 36, 70, 1, 33),
    (129, 100, 31, 2, 64),
    (501, 64, 128, 0, 1000),
]


def random_points(rng, count):
    return rng.uniform(-1, 1, size=(count, 3)).astype(np.float32), unit_rows(rng, count).astype(np.float32)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_agrees_with_the_reference(case):
    """To 1e-5 of the largest output, whatever the sizes; none is a multiple of anything."""
    count, width, feed_forward, blocks, outputs = case
    rng = np.random.default_rng(sum(case))
    network = random_hyper_modulator(rng, outputs, width=width, feed_forward=feed_forward, blocks=blocks)
    points, normals = random_points(rng, count)
    expected = body_modulation(network, points, normals)
    for instruction_set in SETS:
        result = encode_points(network, points, normals, instruction_set=instruction_set)
        assert result.dtype == np.float32 and result.shape == (outputs,)
        np.testing.assert_allclose(result, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    # Network weights as a model file stores them; points as slices of a larger array.
    network = {name: array.astype(np.float16) for name, array in network.items()}
    cloud = np.concatenate([points, normals], axis=1)
    expected = body_modulation(network, points, normals)
    result = encode_points(network, cloud[:, :3], cloud[:, 3:])
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_sharp_attention_agrees():
    """Scores in the hundreds: the running maximum must rescale what came before it, in any order of the points."""
    rng = np.random.default_rng(5)
    network = random_hyper_modulator(rng, 40, width=16)
    network["attention.input.weight"] *= 8
    points, normals = random_points(rng, 300)
    expected = body_modulation(network, points, normals)
    for order in (np.arange(300), np.arange(300)[::-1], rng.permutation(300)):
        for instruction_set in SETS:
            result = encode_points(network, points[order], normals[order], instruction_set=instruction_set)
            np.testing.assert_allclose(result, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


def test_an_overflow_is_not_swallowed():
    """Finite numbers, allowed one by one, whose attention overflows: refused, as the reference gives no number."""
    rng = np.random.default_rng(8)
    network = random_hyper_modulator(rng, 9)
    for name in ("embed.weight", "attention.input.weight", "attention.output.weight"):
        network[name][:] = np.sign(network[name]) * 1e6
    points, normals = random_points(rng, 70)
    points *= 1e6
    for instruction_set in SETS:
        with pytest.raises(ValueError, match="finite"):
            encode_points(network, points, normals, instruction_set=instruction_set)


@pytest.mark.parametrize("name", ["points", "normals", "attention.input.weight", "norm_2.bias", "output.bias"])
def test_values_that_are_not_finite_are_refused(name):
    """Wherever they come in."""
    for value in (np.nan, np.inf, -np.inf):
        rng = np.random.default_rng(7)
        network, (points, normals) = random_hyper_modulator(rng, 9), random_points(rng, 70)
        {"points": points, "normals": normals, **network}[name].reshape(-1)[-1] = value
        with pytest.raises(ValueError, match="finite"):
            encode_points(network, points, normals)


def test_mistakes_are_refused():
    """A row too few in an array that the others have to fit, a missing array, a width that four heads do not divide, no
    points, normals of another number, an unknown set."""
    rng = np.random.default_rng(10)
    network, (points, normals) = random_hyper_modulator(rng, 9), random_points(rng, 70)
    for name in ("embed.weight", "attention.input.bias", "norm_1.weight", "feed_forward.1.weight", "pool.weight"):
        with pytest.raises(ValueError, match="shape|features"):
            encode_points({**network, name: network[name][..., :-1].copy()}, points, normals)
    with pytest.raises(KeyError, match="norm_2"):
        encode_points({name: array for name, array in network.items() if name != "norm_2.weight"}, points, normals)
    with pytest.raises(ValueError, match="multiple of 4"):
        encode_points(random_hyper_modulator(rng, 9, width=10), points, normals)
    with pytest.raises(ValueError, match="no points"):
        encode_points(network, points[:0], normals[:0])
    with pytest.raises(ValueError, match="normals"):
        encode_points(network, points, normals[:-1])
    with pytest.raises(ValueError, match="v9"):
        encode_points(network, points, normals, instruction_set="v9")


def test_a_draper_is_bound_by_it():
    """To the network weights that the reference's modulation folds into."""
    rng = np.random.default_rng(11)
    model = random_model(rng)
    avatar = random_avatar(rng, model.rig)
    points = sample_surface(avatar.vertices, avatar.faces, POINT_COUNT)
    expected = fold_modulation(model.pose_modulator, body_modulation(model.hyper_modulator, *points))
    for (weight, bias), (expected_weight, expected_bias) in zip(Draper(model, avatar).bound.pose_layers, expected):
        np.testing.assert_allclose(weight, expected_weight, rtol=0, atol=1e-5 * np.abs(expected_weight).max())
        np.testing.assert_allclose(bias, expected_bias, rtol=0, atol=1e-5 * np.abs(expected_bias).max())
