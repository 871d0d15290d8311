"""`physkin learn-sway` from end to end, tiny, and what it refuses."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from torch import nn
from training.small_runs import simulate_walkers_quickly, waist_band_model

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_core.outfit.draper import Draper
from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.sway import walker_simulation
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.command import main
from physkin_training.sway.export import exported
from physkin_training.sway.modules import Features, SwayModule, swaying_joints
from physkin_training.sway.shapes import Shapes
from physkin_training.sway.walkers import Walkers
from physkin_training.sway.walkers_file import load_walkers, save_walkers

TINY = ("--bodies", "2", "--walkers", "2", "--rounds", "1", "--seconds", "0.5", "--steps", "3", "--tuning-steps", "2")

SIZED = {entry.name for entry in fields(Walkers)} - {"bodies", "shapes"}


@pytest.fixture(scope="module")
def band(tmp_path_factory):
    path = tmp_path_factory.mktemp("band") / "band.safetensors"
    save_garment_model(waist_band_model(detail_nodes=6), path)
    return path


@pytest.fixture
def quick(monkeypatch):
    simulate_walkers_quickly(monkeypatch)


@pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning: a random model
def test_a_model_learns_to_sway(band, quick, tmp_path, capsys):
    path = tmp_path / "swaying.safetensors"
    assert main([str(band), *TINY, "--device", "cpu", "-o", str(path)]) == 0
    said = capsys.readouterr().out
    for part in ("4 walkers of 0.5 s simulated", "shapes leave", "learnt:", "fine-tuned:", f"wrote {path}"):
        assert part in said
    model = load_garment_model(path)
    body_model = load_body_model()
    draper = Draper(model, avatar_from_body(body_model, body_model.held_out_bodies[0]), precision="fp32")
    still = draper.drape(model.rig.rest, root=np.array([0, 0, 1, 0, 0, 0, 1.0]), time=0.0)
    moved = draper.drape(model.rig.rest, root=np.array([0.05, 0, 1, 0, 0, 0, 1.0]), time=0.05)
    assert np.isfinite(moved).all() and np.abs(moved - still).max() > 1e-5


def test_the_file_sways_as_the_network_that_was_learnt(band, monkeypatch):
    monkeypatch.setattr("physkin_training.sway.body_codes.BODIES", 16)
    model, body_model = load_garment_model(band), load_body_model()
    joints, device = swaying_joints(model, np.ones(len(model.node_rest), dtype=bool)), torch.device("cpu")
    codes = BodyCodes.of(model, body_model, device)
    torch.manual_seed(0)
    network = SwayModule(len(joints), len(codes.directions), 12 * len(model.node_rest)).eval()
    nn.init.normal_(network.out.weight, std=0.01)
    bodies = body_model.held_out_bodies[:1]
    dressed = DressedSamples(model, body_model, bodies, torch.zeros(1, dtype=torch.int64))
    positions = torch.tensor(model.rig.rest, dtype=torch.float32)[None].repeat(2, 1)
    place = torch.tensor([[0, 0, 1.0], [0.05, 0, 1.0]])
    upright = torch.eye(3).repeat(1, 2, 1, 1)
    with torch.no_grad():
        down = torch.tensor([0, 0, -1.0]).repeat(1, 2, 1)
        drive, pose = Features(model.rig, joints, device)(positions[None], place[None], upright, down, 0.05)
        offsets = network(drive, pose, codes(dressed.body_modulation), 0.05)[:, 1].view(1, -1, 3, 4)
        posed = dressed.pose(positions[:1])
        nodes, detail = dressed.draped(positions[:1], torch.tensor([[0, 0, -1.0]]), posed)
        learnt = dressed.skinned(nodes + posed[..., :3] @ offsets, detail)[0].numpy()
    sway = exported(network, (network.out.weight, network.out.bias), joints, codes)
    draper = Draper(replace(model, sway=sway), avatar_from_body(body_model, bodies[0]), precision="fp32")
    draper.outfit = draper.outfit.with_bound_garment(0, draper.layer.bound_visible.unguarded)
    for time, at in zip((0.0, 0.05), place.numpy()):
        drape = draper.drape(model.rig.rest, time=time, root=np.array([*at, 0, 0, 0, 1.0]))[:, :3]
    without = draper.drape(model.rig.rest)[:, :3]
    assert np.abs(learnt - without).max() > 5e-3
    np.testing.assert_allclose(drape, learnt, atol=2e-4)


def test_walkers_are_kept_and_taken_from_their_file(band, quick, tmp_path, capsys):
    kept = tmp_path / "walkers.safetensors"
    first, again = tmp_path / "first.safetensors", tmp_path / "again.safetensors"
    options = (str(band), *TINY, "--device", "cpu", "--walkers-file", str(kept))
    assert main([*options, "-o", str(first)]) == 0
    assert "4 walkers of 0.5 s simulated" in capsys.readouterr().out
    assert main([*options, "-o", str(again)]) == 0
    said = capsys.readouterr().out
    assert f"walkers of {kept}: 4" in said and "simulated" not in said
    assert load_garment_model(again).sway is not None
    with pytest.raises(ValueError, match="were simulated with seed 0, not 1: name another file"):
        main([*options, "--seed", "1", "-o", str(again)])
    with pytest.raises(ValueError, match="holds no simulated walkers"):
        main([*options[:-1], str(first), "-o", str(again)])
    kept.write_bytes(b"no tensors")
    with pytest.raises(ValueError, match="cannot be read"):
        main([*options, "-o", str(again)])


def test_a_file_keeps_walkers_to_the_bit(tmp_path):
    """What is learnt from them again is not compared: between two runs sums may be taken in another order."""
    random = torch.Generator().manual_seed(0)
    fields_of = {name: torch.randn(3, 4, generator=random) for name in SIZED}
    kept = Walkers(
        **fields_of | {"coefficients": fields_of["coefficients"].half(), "valid": fields_of["valid"] > 0},
        bodies=np.arange(6.0).reshape(2, 3),
        shapes=Shapes(*(torch.randn(2, 5, generator=random) for _ in fields(Shapes))),
    )
    save_walkers(kept, {"seed": 0}, tmp_path / "walkers.safetensors")
    taken = load_walkers({"seed": 0}, tmp_path / "walkers.safetensors", torch.device("cpu"))
    for name in SIZED:
        assert torch.equal(getattr(taken, name), getattr(kept, name)), name
    for entry in fields(Shapes):
        assert torch.equal(getattr(taken.shapes, entry.name), getattr(kept.shapes, entry.name)), entry.name
    np.testing.assert_array_equal(taken.bodies, kept.bodies)


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
    new = str(tmp_path / "new.safetensors")
    with pytest.raises(ValueError, match="--walkers-file has the same name"):
        main([str(band), "--walkers-file", new, "-o", new])
    with pytest.raises(ValueError, match="it is the file that is read"):
        main([str(band), "-o", str(band)])


def test_cloth_that_is_lost_teaches_nothing(band, quick, tmp_path, monkeypatch):
    monkeypatch.setattr(walker_simulation, "LARGEST_OFFSET", 0.0)
    with pytest.raises(ValueError, match="cloth was lost in 88% of the frames, allowed 50%"):
        main([str(band), *TINY, "--device", "cpu", "-o", str(tmp_path / "swaying.safetensors")])
