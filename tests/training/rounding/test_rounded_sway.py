"""A sway network on few steps: it moves garment nodes as before, and takes half the room."""

from dataclasses import replace

import numpy as np
import torch
from random_models import random_model, random_sway_network

from physkin_core import load_body_model, load_garment_model, save_garment_model
from physkin_training.dynamics.scenes import RATE_HZ
from physkin_training.rounding import rounded_sway as rounding
from physkin_training.sway.modules import HIDDEN, LAST, OSCILLATORS, READ, Features, SwayModule
from physkin_training.sway.motions import MotionPool


def test_a_rounded_network_sways_the_same_in_fewer_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(rounding, "WALKERS", 12)
    without = random_model(np.random.default_rng(0), rig=load_body_model().rig, rings=20, nodes=128)
    modulation = 2 * sum(len(bias) for _, bias in without.pose_modulator[:-1])
    sizes = {"joints": 12, "states": OSCILLATORS, "widths": (HIDDEN, READ, LAST), "code": 12}
    given = np.random.default_rng(3), len(without.rig.dofs), len(without.node_rest)
    model = replace(without, sway=random_sway_network(*given, modulation=modulation, **sizes))
    sway = rounding.rounded_sway(model.sway, model.rig)
    motions = MotionPool(model.rig).drawn(range(1000, 1004), 120, seed=1)
    parts = (torch.as_tensor(part) for part in (motions.positions, motions.place, motions.turn, motions.gravity))
    seen = Features(model.rig, model.sway.joints, torch.device("cpu"))(*parts, 1 / RATE_HZ)
    codes = torch.randn(4, len(model.sway.code_directions), generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        moved, again = (SwayModule.of(each)(*seen, codes, 1 / RATE_HZ) for each in (model.sway, sway))
    assert 0 < (again - moved).square().mean().sqrt() < 0.15 * moved.square().mean().sqrt()
    bytes_of = []
    for each in (None, model.sway, sway):
        save_garment_model(replace(model, sway=each), tmp_path / "model.safetensors")
        bytes_of.append((tmp_path / "model.safetensors").stat().st_size)
    assert bytes_of[2] - bytes_of[0] < 0.55 * (bytes_of[1] - bytes_of[0])
    for name, array in load_garment_model(tmp_path / "model.safetensors").arrays().items():
        if name.startswith("sway.") and array.ndim == 2 and "code" not in name:
            np.testing.assert_allclose(array, dict(replace(model, sway=sway).arrays())[name], rtol=1e-3, atol=1e-6)
