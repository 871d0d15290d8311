"""`physkin learn-sway` from end to end, tiny, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

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
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.command import main
from physkin_training.sway.modules import Features, SwayModule, swaying_joints

TINY = ("--bodies", "2", "--walkers", "2", "--seconds", "0.5", "--steps", "3", "--tuning-steps", "2")


@pytest.fixture(scope="module")
def band(tmp_path_factory):
    path = tmp_path_factory.mktemp("band") / "band.safetensors"
    save_garment_model(waist_band_model(detail_nodes=6), path)
    return path


@pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning: a random model
def test_a_model_learns_to_sway(band, monkeypatch, tmp_path, capsys):
    simulate_walkers_quickly(monkeypatch)
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
    sway = network.exported((network.out.weight, network.out.bias), joints, codes)
    draper = Draper(replace(model, sway=sway), avatar_from_body(body_model, bodies[0]), precision="fp32")
    draper.outfit = draper.outfit.with_bound_garment(0, draper.layer.bound_visible.without_contact)
    for time, at in zip((0.0, 0.05), place.numpy()):
        drape = draper.drape(model.rig.rest, time=time, root=np.array([*at, 0, 0, 0, 1.0]))[:, :3]
    without = draper.drape(model.rig.rest)[:, :3]
    assert np.abs(learnt - without).max() > 5e-3
    np.testing.assert_allclose(drape, learnt, atol=2e-4)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--bodies", "0"), "--bodies must be at least 1, got 0"),
        (("--bodies", "9999"), "--bodies must be at most 768, got 9999"),
        (("--walkers", "1"), "--walkers must be at least 2, got 1"),
        (("--seconds", "0.4"), "--seconds must be at least 0.5, got 0.4"),
        (("--seconds", "nan"), "--seconds must be at least 0.5, got nan"),
        (("--steps", "0"), "--steps must be at least 1, got 0"),
        (("--tuning-steps", "-1"), "--tuning-steps must be at least 0, got -1"),
        (("--seed", "-1"), "--seed must be at least 0, got -1"),
        (("--device", "abacus"), "unknown device"),
        (("-o", "{folder}/nowhere/x.safetensors"), "there is no folder"),
        (("-o", "{band}"), "it is the file that is read"),
    ],
)
def test_what_is_refused(band, tmp_path, options, said):
    options = [option.format(folder=tmp_path, band=band) for option in options]
    with pytest.raises(ValueError, match=said):
        main([str(band), *TINY, "--device", "cpu", "-o", str(tmp_path / "swaying.safetensors"), *options])
