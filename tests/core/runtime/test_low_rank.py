"""Wide layers of the pose modulator become two: cloth hardly moves, whatever it is made of."""

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_layers

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_body_model, load_garment_model
from physkin_core.model.mlp import fold_modulation
from physkin_core.motion.loading import load_motion
from physkin_core.runtime import low_rank
from physkin_core.runtime.evaluator import drape_poses
from physkin_core.runtime.low_rank import low_rank_layers
from physkin_core.runtime.other_fabrics import other_fabrics

RIG = load_body_model().rig
MOVES = 1.5e-3
"""[m] A tenth of an edge: what the docstring of `DIRECTIONS` allows on average, and half as much again."""


@pytest.fixture(scope="module")
def outfit():
    return Outfit([load_garment_model("tshirt")], load_avatar(BUNDLED_AVATAR, RIG))


def draped(bound):
    dance = load_motion("dance")
    frames = range(0, dance.frame_count, dance.frame_count // 8)
    poses = [(dance.positions_for(RIG)[k].astype(np.float32), dance.gravity[k]) for k in frames]
    return np.array(drape_poses(bound.without_contact, poses))[..., :3]


def test_layers_whose_inputs_span_few_directions_stay_what_they_are():
    """Hidden units of a network that reads three numbers and hardly bends: A B is W for all it is given, but for 8
    bits."""
    rng = np.random.default_rng(0)
    weight = rng.normal(size=(400, 400)).astype(np.float32) / 20
    first = np.zeros((400, RIG.pose_size), dtype=np.float32)
    first[:, :3] = 1e-2 * rng.normal(size=(400, 3))
    zeros = np.zeros(400, dtype=np.float32)
    layers = low_rank_layers([[(first, zeros), (weight, zeros)]], RIG)
    assert [bias.size for _, bias in layers] == [400, 0, 400]
    x = first[:, :3] @ rng.normal(size=(3, 50))
    assert np.abs(layers[2][0] @ (layers[1][0] @ x) - weight @ x).max() < 1e-2 * np.abs(weight @ x).max()


@pytest.mark.parametrize("rank", [0, 7])
def test_a_layer_of_less_rank_stays_finite(rank):
    """As one that training begins with, whose outputs are all zero."""
    rng = np.random.default_rng(2)
    first = random_layers(rng, (RIG.pose_size, 400), output_scale=1.0)
    weight = (rng.normal(size=(400, rank)) @ rng.normal(size=(rank, 400))).astype(np.float32)
    _, (projection, _), (narrow, _) = low_rank_layers([[*first, (weight, np.zeros(400, dtype=np.float32))]], RIG)
    x = rng.normal(size=(400, 5))
    assert np.abs(narrow @ (projection @ x) - weight @ x).max() <= 2e-2 * np.abs(weight @ x).max()


def test_layers_that_have_learnt_their_projections_are_left_as_they_are():
    layers = random_layers(
        np.random.default_rng(1), (RIG.pose_size, 400, 20, 400, 400), output_scale=1.0, projections=(1,)
    )
    assert low_rank_layers([layers], RIG) == layers


def test_narrow_layers_are_left_as_they_are():
    layers = random_layers(np.random.default_rng(1), (RIG.pose_size, 128, 128, 64), output_scale=1.0)
    assert all(a is b for pair, own in zip(low_rank_layers([layers], RIG), layers) for a, b in zip(pair, own))


def test_cloth_hardly_moves(outfit, monkeypatch):
    narrow = outfit.layers[0].bound
    monkeypatch.setattr(low_rank, "DIRECTIONS", 10**6)
    wide = Outfit([load_garment_model("tshirt")], outfit.avatar).layers[0].bound
    sizes = [sum(weight.size for weight, _ in bound.pose_layers) for bound in (narrow, wide)]
    assert sizes[0] < 0.45 * sizes[1]
    assert np.linalg.norm(draped(narrow) - draped(wide), axis=2).mean() < MOVES


def test_other_fabrics_have_directions_of_their_own(outfit, monkeypatch):
    """What a host may change the garment into is as near to the wide network as what it is bound in."""
    layer = outfit.layers[0]
    _, fields = other_fabrics(layer, outfit.avatar, [])
    monkeypatch.setattr(low_rank, "DIRECTIONS", 10**6)
    _, wide = other_fabrics(layer, outfit.avatar, [])
    for modulation in fields["fabric_modulations"]:
        clouds = [
            draped(replace(layer.bound, pose_layers=_made_of(each["fabric_pose_layers"], modulation)))
            for each in (fields, wide)
        ]
        assert np.linalg.norm(clouds[0] - clouds[1], axis=2).mean() < MOVES


def _made_of(layers, modulation):
    """Layers with a modulation folded in, projections left as they are."""
    activated = [layer for layer in layers if len(layer[1])]
    folded = iter(fold_modulation(activated, modulation))
    pairs = [next(folded) if len(layer[1]) else layer for layer in layers]
    return tuple((weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in pairs)
