"""A garment that training gives no sway network learns one, if there is time for it and it pays."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from training.small_runs import simulate_walkers_quickly, waist_band_model

from physkin_core.model.model_file import load_garment_model
from physkin_training.fit_garment import recipe
from physkin_training.sway import walkers
from physkin_training.sway.command import SwayPlan
from physkin_training.time_budget import TimeBudget

CPU, GPU = torch.device("cpu"), torch.device("cuda")


@pytest.fixture
def quick(monkeypatch):
    """As a small GPU run would be, on a CPU."""
    tiny = SwayPlan(bodies=2, walkers=2, rounds=1, seconds=0.5, steps=3, tuning_steps=2)
    monkeypatch.setattr(recipe, "SWAY_PLAN", tiny)
    simulate_walkers_quickly(monkeypatch)


def test_who_learns_it():
    model = waist_band_model()
    swaying = load_garment_model("skirt")
    plenty, few = TimeBudget(15), TimeBudget(3)
    assert recipe.learns_sway(model, GPU, plenty) and recipe.learns_sway(model, GPU, TimeBudget())
    assert recipe.seconds_for_sway(model, GPU, plenty) == recipe.SWAY_SECONDS
    for other in ((model, CPU, plenty), (model, GPU, few), (swaying, GPU, plenty)):
        assert not recipe.learns_sway(*other) and recipe.seconds_for_sway(*other) == 0


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_it_is_kept_where_it_comes_nearer_to_simulated_cloth(quick, monkeypatch):
    model = waist_band_model()
    monkeypatch.setattr(recipe, "WORTH", 0.0)
    without, said = recipe.with_own_sway(model, CPU, TimeBudget())
    assert without is model and "which would gain too little: cloth of simulated walkers" in said
    monkeypatch.setattr(recipe, "WORTH", 1000.0)
    swaying, said = recipe.with_own_sway(model, CPU, TimeBudget())
    assert swaying.sway is not None and "Its own sway network was learnt: cloth of simulated walkers" in said
    assert swaying.sway.out[1].shape == (12 * len(model.node_rest),)


def test_what_cannot_sway_stays_as_it_is(quick, monkeypatch):
    model = waist_band_model()
    monkeypatch.setattr("physkin_training.sway.command.sway_share", lambda model: np.zeros(len(model.node_rest)))
    same, said = recipe.with_own_sway(model, CPU, TimeBudget())
    assert same is model and "It has no sway network:" in said and "lies on chest, shoulders, arms and head" in said


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_gpu_that_takes_too_long_for_it(quick, monkeypatch):
    model = waist_band_model()
    slow = iter(range(0, 100000, 60))
    monkeypatch.setattr(walkers, "time", SimpleNamespace(monotonic=lambda: next(slow)))
    same, said = recipe.with_own_sway(model, CPU, TimeBudget(15))
    assert same is model and "simulating walkers takes" in said and "minutes here, and there are 4.0" in said
