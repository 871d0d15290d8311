"""Figures of cloth in motion: what is measured, and what the command refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from physkin_core import Draper, load_body_model, load_garment_model
from physkin_core.avatar.avatar import avatar_from_body
from physkin_training.dynamics.frame_potential import frame_potentials
from physkin_training.dynamics.reference import Reference, save_reference, swinging_vertices
from physkin_training.dynamics.scenes import load_scene
from physkin_training.evaluate.command import main
from physkin_training.evaluate.dynamic_evaluation import POTENTIAL_EVERY, evaluate_dynamics, played, references_of

CPU = torch.device("cpu")
SECONDS = 3.0


def as_the_model_moves(model, scene, body_model):
    """What a simulation would have written, had its cloth moved as the model's drapes with sway do."""
    coefficients = body_model.held_out_bodies[:1]
    motion = load_scene(scene, model.rig, seconds=SECONDS)
    drapes = played(Draper(model, avatar_from_body(body_model, coefficients[0])), motion)
    vertices = swinging_vertices(model.garment, model.rig)[::10]
    frames = np.arange(POTENTIAL_EVERY, len(drapes), POTENTIAL_EVERY)
    energies = {}
    for name, found in frame_potentials(model, body_model, coefficients[0], motion, drapes, frames, CPU).items():
        energies[name] = np.zeros((1, len(drapes)))
        energies[name][0, frames] = found
    counts, whole = np.array([len(drapes)]), np.array([0])
    return Reference(
        *(model.name, motion, coefficients, vertices, drapes[None, :, vertices], counts),
        *(energies, 0, whole, drapes[whole], {}),
    )


@pytest.fixture(scope="module")
def scores(tmp_path_factory):
    model, body_model, folder = load_garment_model("dress"), load_body_model(), tmp_path_factory.mktemp("references")
    for scene in ("stop", "swing-1"):
        save_reference(as_the_model_moves(model, scene, body_model), folder / f"dress_{scene}.npz")
    return evaluate_dynamics(model, references_of("dress", folder), CPU)


def test_all_scenes_are_in_the_mean(scores):
    total, scenes = scores["dynamic"], scores["scenes"]
    assert scenes.keys() == {"stop", "swing-1"}
    for name in ("rmse_mm", "moving_rmse_mm", "velocity_rmse_ms", "potential_ratio"):
        assert total[name] == pytest.approx(np.mean([scene[name] for scene in scenes.values()]))
        assert total["quasi_static"][name] > 0
    assert total["swings"]["1"]["simulated"]["amplitude_mm"] > 1
    assert total["swings"]["1"]["quasi_static"]["amplitude_mm"] == pytest.approx(0, abs=0.01)
    assert total["stop"]["simulated"]["overshoot_mm"] > total["stop"]["quasi_static"]["overshoot_mm"]
    assert scores["counts"] == {"scenes": 2, "sequences": 2, "frames": 2 * 60 * SECONDS}
    json.dumps(scores)


def test_cloth_that_moves_as_the_reference_is_not_away_from_it(scores):
    """But for what a file rounds away. Without sway it is."""
    total = scores["dynamic"]
    assert total["rmse_mm"] < 0.1 < 1 < total["quasi_static"]["rmse_mm"]
    assert total["potential_ratio"] == pytest.approx(1, abs=1e-3)
    assert abs(total["quasi_static"]["potential_ratio"] - 1) > 1e-3
    for ending in (total["stop"], total["swings"]["1"]):
        assert ending["swaying"] == pytest.approx(ending["simulated"], rel=0.02, abs=0.02)


def test_motion_keeps_its_promises(scores):
    total = scores["dynamic"]
    assert total["rate_divergence_mm"] < 3
    assert total["drop_divergence_mm"] < 5
    assert total["still_mm"] < 0.05
    assert total["added_strain_points"] < 2.5  # what yields under compression is pressed together


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--dynamic", "nowhere"], "of one garment"),
        (["--dynamic", "nowhere", "--outfit", "trousers,tshirt"], "of one garment"),
        (["trousers", "--dynamic", "nowhere"], "no references of 'trousers' in nowhere; physkin simulate trousers"),
        (["tshirt", "--dynamic", "nowhere", "--json", "nowhere/figures.json"], "there is no folder nowhere"),
    ],
)
def test_what_cannot_be_measured_is_said(arguments, said, capsys):
    assert main(arguments) == 2
    assert said in capsys.readouterr().err
