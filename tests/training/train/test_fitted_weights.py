"""Skinning weights fitted to a garment's own cloth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from physkin_core import Draper, load_garment_model
from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.quality import edge_strain
from physkin_training.train.fitted_weights import fitted_weights

SHARE = 0.3
"""Of weights that are spoilt."""


def test_spoilt_weights_are_fitted_again(template):
    """Three tenths of the tank top's are moved on to the next garment node: its cloth, by both sets, is strained less
    after a few steps, and its networks are as they were."""
    shipped = load_garment_model("tanktop")

    def spoilt(weights: np.ndarray) -> np.ndarray:
        return ((1 - SHARE) * weights + SHARE * np.roll(weights, 1, axis=1)).astype(np.float32)

    model = replace(
        shipped, influence_weights=spoilt(shipped.influence_weights), engine_weights=spoilt(shipped.engine_weights)
    )
    fitted = fitted_weights(model, load_body_model(), torch.device("cpu"), steps=12)
    positions, gravity = (part[::9] for part in everyday_poses(model.rig))

    def strain(each) -> float:
        draper = Draper(each, template, fit=0.0)
        return np.mean([edge_strain(each.garment, draper.drape(*pose)[:, :3]) for pose in zip(positions, gravity)])

    for before, after in ((model, fitted), (model.for_engines(), fitted.for_engines())):
        assert strain(after) < 0.7 * strain(before)
    for weights in (fitted.influence_weights, fitted.engine_weights, fitted.detail.weights):
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert fitted.pose_modulator is model.pose_modulator and fitted.garment is model.garment


def test_another_rig_is_refused():
    """A garment of another rig is an error before any step."""
    model = load_garment_model("tanktop")
    heads = model.rig.heads + [0, 0, 0.01]
    with pytest.raises(ValueError, match="'tanktop' has another rig"):
        fitted_weights(replace(model, rig=replace(model.rig, heads=heads)), load_body_model(), torch.device("cpu"))
