"""Skinning without correctives."""

from __future__ import annotations

import dataclasses

import numpy as np

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar
from physkin_core.runtime.bound_garment import plain_skinning


def test_plain_skinning_is_a_model_that_corrects_nothing(garment_model):
    """The evaluator agrees when the node deformer's last layer is zero."""
    *layers, (weight, bias) = garment_model.node_deformer
    plain = dataclasses.replace(garment_model, node_deformer=(*layers, (0 * weight, 0 * bias)))
    draper = Draper(plain, load_avatar(BUNDLED_AVATAR, plain.rig))
    rig = plain.rig
    positions = np.random.default_rng(2).uniform(rig.lower, rig.upper).astype(np.float32)
    skinned = plain_skinning(draper.bound, draper.bone_transforms(positions))
    np.testing.assert_allclose(draper.drape(positions)[:, :3], skinned, atol=1e-5)
