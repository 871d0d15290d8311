"""Hems and hoods sway, cloth that lies on chest and arms does not: by the rule, and in what ships."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core.model.model_file import load_garment_model
from physkin_training.sway.fading import FADES_FROM, GONE_FROM, sway_share


def parts(name: str):
    model = load_garment_model(name)
    bones = np.array(model.rig.bone_names)[model.node_bone]
    arms = np.char.startswith(bones, "upperarm") | np.char.startswith(bones, "lowerarm")
    return model, model.node_rest[:, 2], arms, bones == "head"


@pytest.mark.parametrize("name", ["tshirt", "hoodie"])
def test_a_shirt_sways_at_its_hem_and_hood_alone(name):
    model, height, arms, hood = parts(name)
    share = sway_share(model)
    assert (share[(height < FADES_FROM) & ~arms] == 1).all()
    assert (share[hood] == 1).all()
    assert hood.any() == (name == "hoodie")
    assert share[arms].max() == 0
    chest = (height > GONE_FROM) & ~hood
    assert share[chest].max() == 0
    weight = np.abs(model.sway.out[0]).reshape(len(share), -1).max(axis=1)
    assert ((weight > 0) == (share > 0)).all(), "what ships has that share"


@pytest.mark.parametrize("name", ["skirt", "circleskirt", "widetrousers"])
def test_what_hangs_from_the_hips_sways_as_it_learnt(name):
    model, height, _, _ = parts(name)
    share = sway_share(model)
    assert (share[height < FADES_FROM] == 1).all()
    assert share.mean() > 0.97
