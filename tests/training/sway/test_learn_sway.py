"""`physkin learn-sway` from end to end, tiny, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from training.small_runs import waist_band_model

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_core.runtime.draper import Draper
from physkin_training.sway import body_codes, learning, walker_simulation
from physkin_training.sway.command import main

TINY = ("--bodies", "2", "--walkers", "2", "--rounds", "1", "--seconds", "0.5", "--steps", "3", "--tuning-steps", "2")


@pytest.fixture(scope="module")
def band(tmp_path_factory):
    path = tmp_path_factory.mktemp("band") / "band.safetensors"
    save_garment_model(waist_band_model(node_outputs=12, made_to_measure=True), path)
    return path


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(body_codes, "BODIES", 2)
    monkeypatch.setattr(learning, "BATCH", 4)
    monkeypatch.setattr(walker_simulation, "NEWTON", 1)
    monkeypatch.setattr(walker_simulation, "PRODUCTS", 3)
    monkeypatch.setattr(walker_simulation, "FIRST_STEPS", 1)


@pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning: a random model
def test_a_model_learns_to_sway(band, quick, tmp_path, capsys):
    path = tmp_path / "swaying.safetensors"
    assert main([str(band), *TINY, "--device", "cpu", "-o", str(path)]) == 0
    said = capsys.readouterr().out
    for part in ("4 walkers of 0.5 s simulated", "shapes leave", "learnt:", "fine-tuned:", f"wrote {path}"):
        assert part in said
    model = load_garment_model(path)
    body_model = load_body_model()
    draper = Draper(model, avatar_from_body(body_model, body_model.held_out_bodies[0]), backend="numpy")
    still = draper.drape(model.rig.rest, root=np.array([0, 0, 1, 0, 0, 0, 1.0]), time=0.0)
    moved = draper.drape(model.rig.rest, root=np.array([0.05, 0, 1, 0, 0, 0, 1.0]), time=0.05)
    assert np.isfinite(moved).all() and np.abs(moved - still).max() > 1e-5


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--bodies", "0"), "--bodies must be at least 1, got 0"),
        (("--bodies", "9999"), "--bodies must be at most 512, got 9999"),
        (("--walkers", "0"), "--walkers must be at least 1, got 0"),
        (("--rounds", "0"), "--rounds must be at least 1, got 0"),
        (("--walkers", "1"), "one walker a body is too few"),
        (("--seconds", "0.4"), "--seconds must be at least 0.5, got 0.4"),
        (("--seconds", "nan"), "--seconds must be at least 0.5, got nan"),
        (("--steps", "0"), "--steps must be at least 1, got 0"),
        (("--tuning-steps", "-1"), "--tuning-steps must be at least 0, got -1"),
        (("--seed", "-1"), "--seed must be at least 0, got -1"),
        (("--held-above", "-3"), "--held-above -3 m holds all garment nodes"),
        (("--held-above", "nan"), "--held-above must be a height"),
        (("--device", "abacus"), "unknown device"),
    ],
)
def test_what_is_refused(band, tmp_path, options, said):
    arguments = [str(band), *TINY, "--device", "cpu", "-o", str(tmp_path / "swaying.safetensors"), *options]
    with pytest.raises(ValueError, match=said):
        main(arguments)


def test_files_that_cannot_be_written(band, tmp_path):
    with pytest.raises(ValueError, match="there is no folder"):
        main([str(band), "-o", str(tmp_path / "nowhere" / "x.safetensors")])
    with pytest.raises(ValueError, match="it is what is read"):
        main([str(band), "-o", str(band)])


def test_a_garment_of_turned_nodes_only_is_refused(tmp_path):
    path = tmp_path / "turned.safetensors"
    save_garment_model(waist_band_model(), path)
    with pytest.raises(ValueError, match="gives 9 numbers a garment node, sway needs 12"):
        main([str(path), "--device", "cpu", "-o", str(tmp_path / "swaying.safetensors")])


def test_cloth_that_is_lost_teaches_nothing(band, quick, tmp_path, monkeypatch):
    monkeypatch.setattr(walker_simulation, "LARGEST_OFFSET", 0.0)
    with pytest.raises(ValueError, match="cloth was lost in 88% of the frames, allowed 50%"):
        main([str(band), *TINY, "--device", "cpu", "-o", str(tmp_path / "swaying.safetensors")])
