"""Figures of cloth in motion: what is measured, and what the command refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from physkin_core.model.model_file import load_garment_model
from physkin_training.evaluate.command import main
from physkin_training.evaluate.dynamic_evaluation import REFERENCES, evaluate_dynamics, references_of


@pytest.fixture(scope="module")
def scores():
    stop = [each for each in references_of("tshirt", REFERENCES) if each.motion.name in ("stop", "swing-1")]
    return evaluate_dynamics(load_garment_model("tshirt"), stop, torch.device("cpu"))


def test_all_scenes_are_in_the_mean(scores):
    total, scenes = scores["dynamic"], scores["scenes"]
    assert scenes.keys() == {"stop", "swing-1"}
    for name in ("rmse_mm", "moving_rmse_mm", "velocity_rmse_ms", "potential_ratio"):
        assert total[name] == pytest.approx(np.mean([scene[name] for scene in scenes.values()]))
        assert total["quasi_static"][name] > 0
    assert total["swings"]["1"]["simulated"]["amplitude_mm"] > 1
    assert total["swings"]["1"]["quasi_static"]["amplitude_mm"] == pytest.approx(0, abs=0.01)
    assert total["stop"]["simulated"]["overshoot_mm"] > total["stop"]["quasi_static"]["overshoot_mm"]
    assert scores["counts"] == {"scenes": 2, "sequences": 2, "frames": 552}
    json.dumps(scores)


def test_motion_keeps_its_promises(scores):
    total = scores["dynamic"]
    assert total["rate_divergence_mm"] < 3
    assert total["drop_divergence_mm"] < 5
    assert total["still_mm"] < 0.05
    assert total["added_strain_points"] < 0.2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--dynamic"], "of one garment"),
        (["--dynamic", "--outfit", "trousers,tshirt"], "of one garment"),
        (["trousers", "--dynamic"], "no references of 'trousers'"),
        (["tshirt", "--dynamic", "--json", "nowhere/figures.json"], "there is no folder nowhere"),
    ],
)
def test_what_cannot_be_measured_is_said(arguments, said, capsys):
    assert main(arguments) == 2
    assert said in capsys.readouterr().err
