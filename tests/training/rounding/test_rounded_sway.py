"""A sway network on few steps: it moves garment nodes as before, and takes half the room."""

from dataclasses import replace

import numpy as np
import torch

from physkin_core import load_garment_model, save_garment_model
from physkin_training.dynamics.scenes import RATE_HZ
from physkin_training.rounding import rounded_sway as rounding
from physkin_training.sway.modules import Features
from physkin_training.sway.motions import MotionPool


def test_a_rounded_network_sways_the_same_in_fewer_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(rounding, "WALKERS", 12)
    shipped, random = load_garment_model("skirt"), np.random.default_rng(3)
    layers = {name: getattr(shipped.sway, name) for name in rounding.ROUNDINGS}
    learnt = {name: (w * random.normal(1, 0.05, w.shape).astype(w.dtype), bias) for name, (w, bias) in layers.items()}
    model = replace(shipped, sway=replace(shipped.sway, **learnt))
    sway = rounding.rounded_sway(model.sway, model.rig)
    motions = MotionPool(model.rig).drawn(range(1000, 1004), 120, seed=1)
    parts = (torch.as_tensor(part) for part in (motions.positions, motions.place, motions.turn))
    seen = Features(model.rig, model.sway.joints, torch.device("cpu"))(*parts, 1 / RATE_HZ)
    codes = torch.randn(4, len(model.sway.code_directions), generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        moved, again = (rounding._module(each)(*seen, codes, 1 / RATE_HZ) for each in (model.sway, sway))
    assert 0 < (again - moved).square().mean().sqrt() < 0.15 * moved.square().mean().sqrt()
    sizes = []
    for each in (None, model.sway, sway):
        save_garment_model(replace(model, sway=each), tmp_path / "model.safetensors")
        sizes.append((tmp_path / "model.safetensors").stat().st_size)
    assert sizes[2] - sizes[0] < 0.55 * (sizes[1] - sizes[0])
    for name, array in load_garment_model(tmp_path / "model.safetensors").arrays().items():
        if name.startswith("sway.") and array.ndim == 2 and "code" not in name:
            np.testing.assert_allclose(array, dict(replace(model, sway=sway).arrays())[name], rtol=1e-3, atol=1e-6)
