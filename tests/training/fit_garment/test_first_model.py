"""The shipped garment that training begins with, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from random_models import tube

from physkin_core import Garment
from physkin_core.model.model_file import shipped_models
from physkin_training.config import DetailConfig
from physkin_training.fit_garment.first_model import chosen_start
from physkin_training.fit_garment.recipe import default_recipe, has_sizes_of, started_from


@pytest.fixture(scope="module")
def cropped(shipped):
    """The T-shirt without the lowest part of its trunk, 1 cm wider."""
    garment = shipped("tshirt").garment
    shorter = garment.submesh(garment.vertices[garment.faces][:, :, 2].mean(axis=1) > 0.05)
    return Garment(shorter.vertices * [1.05, 1.03, 1], shorter.faces)


def test_a_cropped_t_shirt_begins_as_the_t_shirt(cropped):
    likeness, verdict = chosen_start(cropped, None)
    assert likeness.model.name == "tshirt" and likeness.mean < 0.015 and likeness.beyond < 0.01
    assert verdict.outcome == "ok" and "tshirt: " in verdict.found and "openings" not in verdict.found


def test_another_start_may_be_asked_for(cropped):
    """Or none; a name that there is not is an error."""
    likeness, verdict = chosen_start(cropped, "skirt")
    assert likeness.model.name == "skirt" and likeness.beyond > 0.5 and "fewer" not in verdict.found
    assert "2 openings more" in verdict.found
    likeness, verdict = chosen_start(cropped, "nothing")
    assert likeness is None and verdict.outcome == "ok" and "as you asked" in verdict.found
    with pytest.raises(ValueError, match="nosuch"):
        chosen_start(cropped, "nosuch")


def test_a_cape_is_far_from_all():
    """A wide cone from the neck to the knees."""
    cone = tube(rings=40, segments=60, radius=1.0, height=1.0)
    height = cone.vertices[:, 2:] - cone.vertices[:, 2].max()
    cape = Garment(cone.vertices * [1, 1, 0] * (0.15 - 0.55 * height) + height * [0, 0, 1] + [0, 0, 0.5], cone.faces)
    likeness, verdict = chosen_start(cape, None)
    assert likeness is None and verdict.outcome == "warning" and "far from all" in verdict.found
    assert np.isfinite(cape.vertices).all()


@pytest.mark.parametrize("kind", ["cpu", "cuda"])
def test_the_default_recipe_can_begin_with_every_shipped_garment(kind, tmp_path, shipped):
    """Which have one size of networks; a recipe of other sizes cannot."""
    recipe = default_recipe("own", tmp_path / "own.obj", torch.device(kind))
    hurried = default_recipe("own", tmp_path / "own.obj", torch.device(kind), seconds=120)
    assert (recipe.train_bodies, hurried.train_bodies) == {"cpu": (64, 64), "cuda": (512, 128)}[kind]
    models = [shipped(name) for name in shipped_models()]
    assert all(has_sizes_of(recipe, model) for model in models)
    assert not has_sizes_of(replace(recipe, detail=DetailConfig()), models[0])
    begun = started_from(recipe, tmp_path / "start.safetensors")
    assert begun.start == tmp_path / "start.safetensors" and begun.optimisation.patience
    assert begun.optimisation.learning_rate < recipe.optimisation.learning_rate
