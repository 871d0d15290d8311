"""A garment that training gives no sway network learns one, if there is time for it and it pays."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from training.small_runs import simulate_walkers_quickly, waist_band_model

from physkin_training.fit_garment import recipe
from physkin_training.sway import walkers
from physkin_training.sway.command import LearntSway, SwayPlan

CPU, GPU = torch.device("cpu"), torch.device("cuda")


@pytest.fixture
def quick(monkeypatch):
    """As a small GPU run would be, on a CPU."""
    tiny = SwayPlan(bodies=2, walkers=2, seconds=0.5, steps=3, tuning_steps=2)
    monkeypatch.setattr(recipe, "SWAY_PLAN", tiny)
    simulate_walkers_quickly(monkeypatch)


def test_who_learns_it(shipped):
    """On a GPU, in a quarter of an hour, who does not begin with a network and has cloth where it sways."""
    band, skirt, tank_top = waist_band_model(), shipped("skirt"), shipped("tanktop")
    arm = band.rig.bone_names.index("upperarm01.L")
    glove = replace(band, node_bone=np.full_like(band.node_bone, arm))
    for start, model, device, seconds, learns in (
        (None, band, GPU, 900, True),
        (None, band, GPU, np.inf, True),
        (tank_top, band, GPU, 900, True),
        (skirt, band, GPU, 900, False),
        (None, band, CPU, 900, False),
        (None, band, GPU, 600, False),
        (None, glove, GPU, 900, False),
    ):
        assert recipe.learns_sway(start, model, device, seconds=seconds) is learns


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_it_is_kept_where_it_comes_nearer_to_simulated_cloth(quick, monkeypatch):
    model = waist_band_model()
    monkeypatch.setattr(recipe, "WORTH", 0.0)
    without, said = recipe.with_own_sway(model, CPU, within=np.inf)
    assert without is model and "one would gain too little: cloth of simulated walkers" in said
    monkeypatch.setattr(recipe, "WORTH", 1000.0)
    swaying, said = recipe.with_own_sway(model, CPU, within=np.inf)
    assert swaying.sway is not None and "Its own sway network was learnt: cloth of simulated walkers" in said
    assert swaying.sway.out[1].shape == (12 * len(model.node_rest),)


def test_what_cannot_sway_stays_as_it_is(quick, monkeypatch):
    model = waist_band_model()
    monkeypatch.setattr("physkin_training.sway.command.sway_share", lambda model: np.zeros(len(model.node_rest)))
    same, said = recipe.with_own_sway(model, CPU, within=np.inf)
    assert same is model and "no sway network:" in said and "lies on chest, shoulders and arms" in said


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_gpu_that_takes_too_long_for_it(quick, monkeypatch):
    model = waist_band_model()
    slow = iter(range(0, 100000, 60))
    monkeypatch.setattr(walkers, "time", SimpleNamespace(monotonic=lambda: next(slow)))
    same, said = recipe.with_own_sway(model, CPU, within=240.0)
    assert same is model and "simulating walkers takes" in said and "minutes here, and there are 4.0" in said


@pytest.mark.parametrize("error", [torch.cuda.OutOfMemoryError("out of memory"), torch.linalg.LinAlgError("singular")])
def test_a_failure_leaves_the_trained_model(error, monkeypatch):
    def fails(*_, **__):
        raise error

    model = waist_band_model()
    monkeypatch.setattr(recipe, "learn_sway", fails)
    same, said = recipe.with_own_sway(model, CPU, within=np.inf)
    assert same is model and str(error) in said


def test_figures_that_are_none_are_no_gain(monkeypatch, shipped):
    model, sway = waist_band_model(), shipped("skirt").sway
    monkeypatch.setattr(recipe, "rounded_sway", lambda *_: None)
    monkeypatch.setattr(recipe, "learn_sway", lambda *_, **__: LearntSway(sway, np.nan, np.nan))
    same, said = recipe.with_own_sway(model, CPU, within=np.inf)
    assert same is model and "too little" in said
