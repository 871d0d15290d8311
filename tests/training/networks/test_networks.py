"""The networks in torch: the values of the reference, and the standard transformer layer the paper names."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from random_models import random_hyper_modulator, random_model, unit_rows
from reference.hyper_modulator import body_modulation

from physkin_core.model.hyper_modulator import at_fit, bending_code, with_bending
from physkin_core.model.mlp import modulation_size
from physkin_training.config import NetworkConfig
from physkin_training.networks.garment_nodes import DetailNodeSet
from physkin_training.networks.networks import HyperModulator, Networks


def as_double(*arrays):
    return [torch.as_tensor(np.asarray(array), dtype=torch.float64) for array in arrays]


@pytest.mark.parametrize("width, blocks, count", [(8, 2, 50), (32, 1, 600), (4, 0, 3)])
def test_hyper_modulator_agrees(width, blocks, count):
    """Points, attention, pooling and residual blocks; bodies of a batch do not see each other."""
    rng = np.random.default_rng(width)
    model = random_model(rng, width=width)
    arrays = random_hyper_modulator(rng, modulation_size(model.pose_modulator), width=width, blocks=blocks)
    config = NetworkConfig(token_width=width, feed_forward=16, residual_blocks=blocks)
    twin = HyperModulator(config, modulation_size(model.pose_modulator))
    twin.load_state_dict({name: torch.as_tensor(array) for name, array in arrays.items()})
    points = rng.uniform(-1, 1, size=(3, count, 3)).astype(np.float32)
    normals = np.stack([unit_rows(rng, count) for _ in range(3)]).astype(np.float32)
    with torch.no_grad():
        result = twin(torch.as_tensor(points), torch.as_tensor(normals)).numpy()
        double = twin.double()(*as_double(points, normals)).numpy()
    for body in range(3):
        expected = body_modulation(arrays, points[body], normals[body])
        np.testing.assert_allclose(result[body], expected, atol=3e-5)
        np.testing.assert_allclose(double[body], expected, atol=3e-5)
    assert np.abs(result[0] - result[1]).max() > 1e-3


@pytest.mark.parametrize(
    ("given", "folded", "values"),
    [
        (lambda fits: (torch.tensor(fits),), at_fit, [0.0, 0.4, 1.0]),
        (lambda times: (None, torch.tensor([bending_code(each) for each in times])), with_bending, [1.0, 0.5, 16.0]),
    ],
    ids=["fit", "bending"],
)
def test_fit_and_bending_shift_tokens_as_at_the_run_time(given, folded, values):
    """Each body with its own, against the reference with that folded in; without any, as with the first value."""
    rng = np.random.default_rng(2)
    arrays = random_hyper_modulator(rng, 20)
    twin = HyperModulator(NetworkConfig(token_width=8, feed_forward=16, residual_blocks=2), 20)
    twin.load_state_dict({name: torch.as_tensor(array) for name, array in arrays.items()})
    points = rng.uniform(-1, 1, size=(1, 60, 3)).astype(np.float32).repeat(3, axis=0)
    normals = unit_rows(rng, 60).astype(np.float32)[None].repeat(3, axis=0)
    pair = torch.as_tensor(points), torch.as_tensor(normals)
    with torch.no_grad():
        result, plain = twin(*pair, *given(values)).numpy(), twin(*pair).numpy()
    for body, value in enumerate(values):
        expected = body_modulation(folded(arrays, value), points[body], normals[body])
        np.testing.assert_allclose(result[body], expected, atol=3e-5)
    np.testing.assert_array_equal(plain[0], result[0])
    assert np.abs(result[2] - result[0]).max() > 0.01


def test_the_encoder_is_one_standard_transformer_layer():
    """`torch.nn.TransformerEncoderLayer` with 4 heads, post-norm and ReLU between embedding and pooling."""
    torch.manual_seed(0)
    config = NetworkConfig(token_width=16, feed_forward=24, residual_blocks=0)
    network = HyperModulator(config, 5).double()
    layer = torch.nn.TransformerEncoderLayer(16, 4, 24, dropout=0.0, batch_first=True, dtype=torch.float64)
    twin = {
        "self_attn.in_proj_weight": network.attention["input"].weight,
        "self_attn.in_proj_bias": network.attention["input"].bias,
        "self_attn.out_proj.weight": network.attention["output"].weight,
        "self_attn.out_proj.bias": network.attention["output"].bias,
        "linear1.weight": network.feed_forward[0].weight,
        "linear1.bias": network.feed_forward[0].bias,
        "linear2.weight": network.feed_forward[1].weight,
        "linear2.bias": network.feed_forward[1].bias,
        "norm1.weight": network.norm_1.weight,
        "norm1.bias": network.norm_1.bias,
        "norm2.weight": network.norm_2.weight,
        "norm2.bias": network.norm_2.bias,
    }
    layer.load_state_dict({name: tensor.detach() for name, tensor in twin.items()})
    points, normals = torch.randn(2, 2, 30, 3, dtype=torch.float64)
    frequency = torch.pi * 2.0 ** torch.arange(6, dtype=torch.float64)
    angles = (points[..., None] * frequency).reshape(2, 30, 18)
    tokens = layer(network.embed(torch.cat([points, angles.sin(), angles.cos(), normals], dim=-1)))
    pooled = (torch.softmax(network.pool(tokens), dim=1) * tokens).sum(dim=1)
    torch.testing.assert_close(network(points, normals), network.output(pooled), rtol=1e-9, atol=1e-10)


def test_new_networks_correct_almost_nothing():
    """Training starts from plain skinning: correctives of a millimetre or so."""
    torch.manual_seed(2)
    networks = Networks(NetworkConfig(pose_hidden=64, deformer_hidden=32, token_width=16), pose_size=20, node_count=9)
    body = networks.hyper_modulator(torch.randn(4, 100, 3), torch.randn(4, 100, 3))
    raw, _ = networks(body, torch.rand(4, 20) * 2 - 1, torch.randn(4, 9, 3, 4))
    assert raw.shape == (4, 9, 12) and 0 < raw.abs().max() < 0.03


def test_last_layers_learn_in_units_of_what_they_correct():
    """Linear parts in fifths, translations and detail in 3 cm; what comes before them as it is."""
    config = NetworkConfig(pose_hidden=8, deformer_hidden=6, token_width=4, feed_forward=4)
    detail = DetailNodeSet(5, 7, np.zeros((9, 1), dtype=int), np.ones((9, 1)))
    networks = Networks(config, pose_size=5, node_count=3, detail=detail)
    units = {name: networks.output_units().get(parameter) for name, parameter in networks.named_parameters()}
    last = f"node_deformer.layers.{config.deformer_layers}"
    of_nodes = torch.tensor([[0.2] * 9 + [0.03] * 3] * 3).flatten()
    torch.testing.assert_close(units.pop(f"{last}.bias"), of_nodes)
    torch.testing.assert_close(units.pop(f"{last}.weight"), of_nodes[:, None])
    assert float(units.pop("detail.offsets.weight")) == pytest.approx(0.03)
    assert not any(unit is not None for unit in units.values())


def test_normalised_nodes_fold_into_the_first_layer():
    """Inputs of mean 0 and spread 1, numbers that hardly vary left out; the folded layer gives the same."""
    torch.manual_seed(3)
    config = NetworkConfig(pose_hidden=8, deformer_hidden=6, token_width=4, feed_forward=4)
    networks = Networks(config, pose_size=5, node_count=3).double()
    posed = 2 + 0.5 * torch.randn(4000, 3, 3, 4, dtype=torch.float64)
    posed[:, 1, 0, 0] = 1.0
    networks.normalise_nodes(posed)
    inputs = (posed.flatten(1) - networks.node_mean) * networks.node_scale
    assert inputs.mean(dim=0).abs().max() < 1e-9
    constant = 12
    assert inputs[:, constant].abs().max() == 0
    others = torch.arange(36) != constant
    torch.testing.assert_close(inputs[:, others].std(dim=0), torch.ones(35, dtype=torch.float64))
    weight, bias = networks.folded_first_layer()
    expected = networks.node_deformer.layers[0](inputs)
    torch.testing.assert_close(posed.flatten(1) @ weight.T + bias, expected)
