"""Learning comes nearer to walkers that are held out, and fine-tuning lets cloth strain less."""

from __future__ import annotations

import math

import pytest
import torch
from training.small_runs import simulate_walkers_quickly, waist_band_model

from physkin_core.avatar.body_model import load_body_model
from physkin_training.sway import cloth_tuning, learning, walker_simulation
from physkin_training.sway import walkers as walkers_module
from physkin_training.sway.body_codes import BodyCodes
from physkin_training.sway.cloth_tuning import OffsetLayer, tuned_network
from physkin_training.sway.fading import sway_share
from physkin_training.sway.learning import held_out_millimetres, learnt_network, split
from physkin_training.sway.modules import Features, swaying_joints
from physkin_training.sway.walkers import simulated_walkers
from physkin_training.sway.windows import Windows

BODY_MODEL = load_body_model()
CPU = torch.device("cpu")


OPTIONS = dict(bodies=2, each=4, seconds=0.5, seed=0, within=math.inf, say=lambda text: None)


@pytest.fixture(scope="module")
def band():
    """A model, eight walkers on two bodies, four at a time, and what the network sees of them."""
    model = waist_band_model()
    with pytest.MonkeyPatch.context() as patch:
        simulate_walkers_quickly(patch)
        patch.setattr(walkers_module, "AT_ONCE", 2)
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        codes = BodyCodes.of(model, BODY_MODEL, CPU)
        walkers = simulated_walkers(model, BODY_MODEL, codes, sway_share(model), CPU, **OPTIONS)
        yield model, walkers, Features(model.rig, swaying_joints(model, walkers.share.numpy() > 0), CPU)
        torch.set_num_threads(threads)


def learnt(band, steps):
    model, walkers, features = band
    generator = torch.Generator().manual_seed(0)
    some, held_out = split(walkers, generator)
    joints = len(swaying_joints(model, walkers.share.numpy() > 0))
    network = learnt_network(walkers, features, some, generator, joints=joints, steps=steps)
    return network, some, held_out


def test_of_every_body_some_walkers_are_learnt(band):
    _, walkers, _ = band
    for seed in range(5):
        some, held_out = split(walkers, torch.Generator().manual_seed(seed))
        assert len(held_out) == 1
        assert set(some.tolist()) | set(held_out.tolist()) == set(range(8)) and len(some) == 7
        assert set(walkers.body[some].tolist()) == {0, 1}


def test_learning_comes_nearer_and_is_the_same_again(band, monkeypatch):
    monkeypatch.setattr(learning, "BATCH", 8)
    monkeypatch.setattr(learning, "WARM_UP_STEPS", 5)
    monkeypatch.setattr(learning, "LEARNING_RATE", 2e-2)
    _, walkers, features = band
    first, some, _ = learnt(band, 3)
    later, _, _ = learnt(band, 60)
    before, after = (held_out_millimetres(walkers, features, some, each.out, each) for each in (first, later))
    assert after < 0.9 * before
    again, _, _ = learnt(band, 3)
    torch.testing.assert_close(again.out.weight, first.out.weight, rtol=0, atol=0)


def test_cloth_that_is_lost_teaches_nothing(band, monkeypatch):
    """In all frames of 30 but the first one; every fourth is kept."""
    simulate_walkers_quickly(monkeypatch)
    monkeypatch.setattr(walker_simulation, "LARGEST_OFFSET", 0.0)
    model, walkers, _ = band
    with pytest.raises(ValueError, match="cloth was lost in 88% of the frames, allowed 50%"):
        simulated_walkers(model, BODY_MODEL, lambda modulation: None, sway_share(model), CPU, **OPTIONS)


def test_tuning_lets_cloth_strain_less(band, monkeypatch):
    """With energies that outweigh what was simulated."""
    monkeypatch.setattr(learning, "BATCH", 8)
    for name, value in (("ENERGY", 1e4), ("WARM_UP_STEPS", 1), ("LAST_LAYER", 1.0), ("LEARNING_RATE", 3e-3)):
        monkeypatch.setattr(cloth_tuning, name, value)
    model, walkers, features = band
    network, some, _ = learnt(band, 30)
    cloth = cloth_tuning._Cloth(model, BODY_MODEL, walkers)
    walker, frame = torch.tensor([1, 6]), torch.full((2,), 7)  # one on each body

    def energy(last: OffsetLayer) -> float:
        windows = Windows(walkers, features)
        with torch.no_grad():
            offsets = last(windows.at(walker, stride=4).hidden(network)[:, -1])
        cloth.forces(offsets, walker, frame)
        strained = ("stretch", "bend", "collision", "band")
        return sum(float(each.values.sum()) for each in cloth._potential.energies if each.name in strained)

    before = energy(OffsetLayer(network.out, walkers))
    generator = torch.Generator().manual_seed(1)
    last = tuned_network(model, BODY_MODEL, walkers, features, network, some, generator, steps=80)
    assert energy(last) < 0.95 * before
