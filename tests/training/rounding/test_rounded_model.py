"""Garment models with all large networks rounded: they drape the same, in fewer bytes."""

import numpy as np
import pytest
from random_models import random_model

from physkin_core import Draper, load_avatar, load_body_model, save_garment_model
from physkin_core.avatar.loading import BUNDLED_AVATAR
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_training.rounding import rounded_model as rounded_models
from physkin_training.rounding.compensated_rounding import Rounding, compensated_rounding
from physkin_training.rounding.rounded_model import rounded_model


def test_a_layer_makes_up_for_what_rounding_did_to_its_inputs():
    """Inputs that are all a little too large are taken for less."""
    random = np.random.default_rng(3)
    weight, inputs = random.normal(size=(40, 64)), random.normal(size=(500, 8)) @ random.normal(size=(8, 64))
    given = 1.1 * inputs
    rounded = rounded_models._Pass(inputs, given).round(weight, Rounding(2))
    errors = [
        np.abs(given @ each.T - inputs @ weight.T).mean()
        for each in (rounded, compensated_rounding(weight, given.T @ given / len(given), Rounding(2)))
    ]
    assert errors[0] < 0.3 * errors[1]


def test_a_network_that_reads_nothing_is_rounded():
    """Of layers that training has put to sleep."""
    weight = np.random.default_rng(3).normal(size=(40, 64))
    nothing = rounded_models._Pass(np.zeros((50, 64)), np.zeros((50, 64)))
    np.testing.assert_allclose(nothing.round(weight, Rounding(1)), weight, atol=0.03)


@pytest.mark.parametrize("pose_rank", [0, 24])
def test_a_rounded_model_drapes_the_same_in_fewer_bytes(pose_rank, tmp_path, monkeypatch):
    for name, value in {"BODIES": 2, "EVERY": 60, "EVERYDAY": 50, "FARTHER": 30, "ENCODED_BODIES": 20}.items():
        monkeypatch.setattr(rounded_models, name, value)
    rig = load_body_model().rig
    widths = {"pose_widths": (64,) * 3, "deformer_widths": (64,) * 3, "width": 32, "pose_rank": pose_rank}
    model = random_model(np.random.default_rng(0), rig=rig, rings=20, nodes=40, detail_nodes=30, **widths)
    rounded, finely = rounded_model(model), rounded_model(model, finely=True)
    sizes = []
    for each in (model, rounded, finely):
        save_garment_model(each, tmp_path / "model.safetensors")
        sizes.append((tmp_path / "model.safetensors").stat().st_size)
    assert sizes[1] < sizes[2] < sizes[0]
    avatar = load_avatar(BUNDLED_AVATAR, model.rig)
    poses = list(zip(*everyday_poses(rig)))[::4]
    exact, *others = (
        np.array([Draper(each, avatar).drape(*pose)[:, :3] for pose in poses]) for each in (model, rounded, finely)
    )
    moved = [np.linalg.norm(other - exact, axis=-1).mean() for other in others]
    assert 0 < moved[1] < 0.9 * moved[0] < 4e-3, "eight bits alone move random networks by 1 to 2 mm"


def test_a_model_of_another_rig_is_refused():
    with pytest.raises(ValueError, match="this garment has another rig"):
        rounded_model(random_model(np.random.default_rng(0)))
