"""Many figures that wear the same: what is equal is bound once and kept once, as long as somebody uses it."""

import gc

import numpy as np
import pytest
from random_models import random_avatar, random_model

from physkin_core import Outfit, WornGarment
from physkin_core.outfit import dressing


@pytest.fixture
def binds(monkeypatch):
    """What has been bound, by name."""
    bound, bind_garment = [], dressing.bind_garment

    def counted(model, *given, **options):
        bound.append(model.name)
        return bind_garment(model, *given, **options)

    monkeypatch.setattr(dressing, "bind_garment", counted)
    return bound


@pytest.fixture
def figure():
    rng = np.random.default_rng(0)
    model = random_model(rng)
    return model, random_avatar(rng, model.rig)


def test_a_figure_that_is_dressed_again_is_bound_once(figure, binds):
    """Ten outfits of one garment on one avatar share all that does not change with the pose, and drape alike."""
    model, avatar = figure
    first, *others = [Outfit([model], avatar) for _ in range(10)]
    assert len(binds) == 1
    (cloud,) = first.drape(model.rig.rest)
    for outfit in others:
        assert outfit.layers is first.layers
        assert outfit.frame_input is not first.frame_input, "its frames are its own"
        np.testing.assert_array_equal(outfit.drape(model.rig.rest)[0], cloud)


def test_what_is_worn_otherwise_is_bound_anew(figure, binds):
    """Another avatar object, or way to wear it; a truth value is no fit, whatever has been bound."""
    model, avatar = figure
    rng = np.random.default_rng(1)
    kept = [Outfit([model], avatar), Outfit([model], random_avatar(rng, model.rig))]
    kept += [Outfit([model], avatar, own_clothes="hide"), Outfit([model], avatar, fit=0.0)]
    assert len(binds) == len(kept)
    with pytest.raises(ValueError, match="fit must be 0"):
        Outfit([model], avatar, fit=False)
    with pytest.raises(ValueError, match="fit must be 0"):
        Outfit([WornGarment(model, fit=[0.0])], avatar)


def test_what_nobody_uses_any_more_is_bound_again(figure, binds):
    """Nothing is kept beyond the last outfit."""
    model, avatar = figure
    outfit = Outfit([model], avatar)
    del outfit
    gc.collect()
    Outfit([model], avatar)
    assert len(binds) == 2
