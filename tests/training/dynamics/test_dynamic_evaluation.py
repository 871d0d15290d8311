"""Figures of cloth in motion: what is measured, and what the command refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from physkin_core import Draper, load_body_model, load_garment_model
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.cli import main
from physkin_training.dynamics.reference import Reference, load_reference, rounded, save_reference
from physkin_training.dynamics.scenes import load_scene
from physkin_training.evaluate.dynamic_evaluation import (
    evaluate_dynamics,
    played,
    references_of,
    settling,
    swing,
    swinging_vertices,
)

SECONDS = 3.0


@pytest.fixture(scope="module")
def scores(tmp_path_factory):
    """Of references that a simulation would have written, had its cloth moved as the model's drapes with sway do."""
    model, body_model, folder = load_garment_model("dress"), load_body_model(), tmp_path_factory.mktemp("references")
    bodies = body_model.held_out_bodies[:1]
    draper = Draper(model, avatar_from_body(body_model, bodies[0]))
    for scene in ("stop", "swing-1"):
        motion = load_scene(scene, model.rig, seconds=SECONDS)
        drapes = rounded(played(draper, motion))
        save_reference(
            Reference("dress", motion, bodies, drapes[None], np.array([len(drapes)])), folder / f"dress_{scene}.npz"
        )
    return evaluate_dynamics(model, references_of("dress", folder))


def test_all_scenes_are_in_the_mean(scores):
    total, scenes = scores["dynamic"], scores["scenes"]
    assert scenes.keys() == {"stop", "swing-1"}
    for name in ("rmse_mm", "moving_rmse_mm"):
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
    for ending in (total["stop"], total["swings"]["1"]):
        assert ending["swaying"] == pytest.approx(ending["simulated"], rel=0.02, abs=0.02)
    assert total["added_strain_points"] < 2.5  # what yields under compression is pressed together


def test_a_reference_is_read_as_it_was_written(tmp_path):
    """To a tenth of a millimetre; what is out of all bounds is where the root is."""
    generator, motion = np.random.default_rng(0), load_scene("turn", load_body_model().rig, seconds=3.0)
    vertices = generator.uniform(-3, 3, size=(2, 180, 5, 3))
    kept = rounded(vertices)
    written = Reference("skirt", motion, generator.normal(size=(2, 4)), kept, np.array([180, 90]))
    save_reference(written, tmp_path / "skirt_turn.npz")
    read = load_reference(tmp_path / "skirt_turn.npz")
    assert np.abs(read.simulated(0) - vertices[0]).max() <= 0.51e-4 and len(read.simulated(1)) == 90
    np.testing.assert_array_equal(read.motion.positions, motion.positions)
    assert (read.motion.name, read.motion.joint_names, read.garment) == ("turn", motion.joint_names, "skirt")
    assert (rounded(np.array([4.0, -np.inf, np.nan])) == 0).all()
    (tmp_path / "other_turn.npz").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="no reference"):
        load_reference(tmp_path / "other_turn.npz")


def test_what_swings_is_below_the_hips():
    model = load_garment_model("dress")
    assert model.garment.vertices[swinging_vertices(model.garment, model.rig), 2].max() < 0


def test_amplitude_phase_and_settling_are_those_of_a_known_swing():
    rig = load_body_model().rig
    scene = load_scene("swing-1", rig, seconds=5.0)
    times, points = np.arange(300) / 60, np.zeros((300, 9, 3))
    points[:, :, 2] = np.arange(9)
    points[:, :, 1] = 0.03 * np.sin(2 * np.pi * (times - 0.25) - np.radians(40))[:, None]
    found = swing(points, scene, 1.0)
    assert found["amplitude_mm"] == pytest.approx(30, rel=0.02)
    assert found["phase_degrees"] == pytest.approx(-40, abs=2)
    stop = load_scene("stop", rig, seconds=5.0)
    after = np.maximum(times - 2.25, 0)
    points[:, :, 1] = 0
    points[:, :, 0] = (0.1 * np.exp(-4 * after) * (times >= 2.25))[:, None]
    found = settling(points, points, stop)
    assert found["overshoot_mm"] == pytest.approx(100, rel=0.1)
    assert found["settling_s"] == pytest.approx(np.log(10) / 4, abs=0.05)


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
    assert main(["evaluate", *arguments]) == 2
    assert said in capsys.readouterr().err
