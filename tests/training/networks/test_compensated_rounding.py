"""Network weights rounded to eight bits: on the native evaluator's steps, and closer than rounded one by one."""

import numpy as np
import pytest

from physkin_core import Draper, load_avatar, load_garment_model
from physkin_core.avatar.loading import BUNDLED_AVATAR
from physkin_core.model.model_file import shipped_models
from physkin_core.motion.loading import load_motion
from physkin_training.networks.compensated_rounding import STEPS, compensated_rounding


def in_steps(weight):
    return weight / np.abs(weight).max(axis=1, keepdims=True) * STEPS


def test_outputs_are_closer_than_rounded_one_by_one():
    """Inputs that hang together leave room for it: here a tenth of the error."""
    random = np.random.default_rng(3)
    weight = random.normal(size=(40, 64)).astype(np.float32)
    inputs = random.normal(size=(500, 8)) @ random.normal(size=(8, 64))
    rounded = compensated_rounding(weight, inputs)
    np.testing.assert_allclose(in_steps(rounded), np.rint(in_steps(rounded)), atol=1e-4)
    largest = np.abs(weight).max(axis=1)
    np.testing.assert_array_equal(np.abs(rounded).max(axis=1), largest)
    one_by_one = np.rint(in_steps(weight)) * largest[:, None] / STEPS
    errors = [np.abs(inputs @ (each - weight).T).mean() for each in (rounded, one_by_one)]
    assert errors[0] < 0.2 * errors[1]


@pytest.mark.parametrize("name", shipped_models())
def test_shipped_models_lose_nothing_more_in_eight_bits(name):
    """They are stored rounded, so that int8 is 0.2 to 0.4 mm from fp32, as bf16 is; one by one 0.6 to 0.9."""
    model = load_garment_model(name)
    for weight, _ in (*model.pose_modulator[1:], *model.node_deformer[1:]):
        assert np.abs(in_steps(weight) - np.rint(in_steps(weight))).max() < 0.3
    avatar, clip = load_avatar(BUNDLED_AVATAR, model.rig), load_motion("dance")
    exact, rounded = (Draper(model, avatar, precision=precision) for precision in ("fp32", "int8"))
    moved = [
        np.linalg.norm(rounded.drape(q, down)[:, :3] - exact.drape(q, down)[:, :3], axis=1).mean()
        for q, down in zip(clip.positions_for(model.rig)[::20], clip.gravity[::20])
    ]
    assert np.mean(moved) < 0.45e-3
