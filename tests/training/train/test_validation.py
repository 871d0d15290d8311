"""The best model of a run: what is measured, when, that training does not notice, and that it is the one exported."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from training.small_runs import run, small_config

from physkin_core import load_body_model
from physkin_core.model.hyper_modulator import BENDING_OCTAVES
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.rest_data import RestData
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.sampling.posed_bodies import PosedBodies
from physkin_training.train.run import best_model
from physkin_training.train.trainer import Trainer
from physkin_training.train.validation import Validation

CPU = torch.device("cpu")
BODY = load_body_model()


@pytest.fixture(scope="module")
def trainer(tmp_path_factory):
    return Trainer(small_config(tmp_path_factory.mktemp("run")), CPU)


def wearing_of(trainer):
    return Wearing.of(trainer.garment, BODY).worn_faces()


def test_the_energy_is_the_mean_over_the_set(trainer):
    """Of the template and made to measure, heavy poses counting less, against each sample alone in as large a batch, at
    the material's stiffness and with the body points of the run time. At its own place there: rounding elsewhere makes
    single contacts flip."""
    validation, drape, material = trainer.validation, trainer.averaged, trainer.config.material
    trainer.losses.collision.stiffness.fill_(1.0)  # training's own must not matter
    wearing = wearing_of(trainer)
    count = trainer.config.optimisation.samples
    posed = PosedBodies(BODY, trainer.bodies, count, faces=wearing.faces)
    rest = RestData(trainer.garment, material, CPU, shapes=trainer.fits.shapes)
    options = {"wearing": wearing, "linear_beyond": 0.01, "leads_back": True, "rest": rest}
    losses = PhysicsLosses(trainer.garment, material, count, CPU, **options)
    surfaces = trainer.bodies.vertices.numpy(), trainer.bodies.faces.numpy()
    modulations = [encode_bodies(drape, *surfaces, fit=fit) for fit in (0.0, 1.0)]
    energies: list[list[torch.Tensor]] = [[], []]
    with torch.no_grad():
        for batch, chosen in enumerate(validation.chosen):
            for sample, body in enumerate(chosen.repeat_interleave(count // len(chosen))):
                bodies = body.repeat(count)
                q, g = (values[batch, sample].repeat(count, 1) for values in (validation.positions, validation.gravity))
                bones = posed.pose(q, bodies)
                for made in (False, True):
                    worn = trainer.fits.worn(bodies, torch.tensor([made]).repeat(count))
                    losses.rest_row.copy_(worn.rows)
                    nodes = drape.posed_nodes(bones, worn.node_positions)
                    x = drape(modulations[made][bodies], q, g, nodes, worn.rest)
                    found = losses(x, g, posed.mesh, posed.offset)[1]
                    energies[made].append(torch.stack([found.strained, found.gravity])[:, sample])
    assert len(energies[0]) == len(validation.chosen) * count
    strained, heights = torch.stack([torch.stack(each, dim=1) for each in energies]).double().unbind(dim=1)
    light = 2 * 0.1 * ((1 + strained / 0.1).sqrt() - 1)
    assert validation.energy(drape) == pytest.approx((light + heights).mean().item(), rel=1e-5)
    assert validation.made_to_measure == pytest.approx((light + heights)[1].mean().item(), rel=1e-5)
    assert validation.strained == pytest.approx(light.mean().item(), rel=1e-5)


def test_poses_are_drawn_from_the_full_range(trainer):
    positions = trainer.validation.positions.flatten(0, 1)
    share = (positions - trainer.sampler.lower) / (trainer.sampler.upper - trainer.sampler.lower)
    assert share.min() >= 0 and share.max() <= 1
    assert share.min() < 0.05 and share.max() > 0.95
    assert len(positions.unique(dim=0)) == len(positions)


def spoken(monkeypatch, energies):
    """Let validation say these energies one after the other; returns how often it was asked."""
    remaining = list(energies)
    monkeypatch.setattr(Validation, "energy", lambda *_: remaining.pop(0))
    return remaining


def test_training_does_not_notice(tmp_path):
    """Measured after every step or never before the end: the same networks, bit for bit, and the same random state."""
    often = Trainer(small_config(tmp_path, growth=0.0, prune_from=0.0, prune_at=0.0, validate_every=1), CPU)
    list(often.run(2))
    state = torch.get_rng_state()
    assert often.best is not None
    seldom = Trainer(small_config(tmp_path, growth=0.0, prune_from=0.0, prune_at=0.0, validate_every=500), CPU)
    list(seldom.run(2))
    assert torch.equal(torch.get_rng_state(), state)
    assert seldom.best is None and seldom.best_drape() is seldom.averaged
    for (name, left), right in zip(often.drape.named_parameters(), seldom.drape.parameters(), strict=True):
        assert torch.equal(left, right), name


def test_the_lowest_is_kept_once_range_and_influences_are_final(tmp_path, monkeypatch):
    """Asked at every step from the one after which both are final; what is not finite is never the best."""
    # Full range from the seventh step on, all pruned from the eighth on.
    trainer = Trainer(small_config(tmp_path, prune_at=0.65, validate_every=1, full_encoding=1.0), CPU)
    remaining = spoken(monkeypatch, [math.nan, 3.0, 1.0, 2.0, 1.5])
    seen, averages = [], {}
    for step in trainer.run(12):
        seen.append((step, trainer.best and trainer.best.step, trainer.validation_energy))
        averages[step] = trainer.averaged.skinning_logits.detach().clone()
    assert not remaining
    assert seen[6][1:] == (None, None)
    assert [entry[1] for entry in seen[7:]] == [None, 9, 10, 10, 10]
    assert trainer.best.energy == 1.0 and trainer.validation_energy == 1.5
    best = trainer.best_drape()
    assert torch.equal(best.skinning_logits, averages[10]) and not torch.equal(averages[10], averages[12])
    assert torch.equal(best.influence_bias, trainer.averaged.influence_bias)
    assert torch.equal(trainer.averaged.skinning_logits, averages[12])


def test_the_best_waits_for_the_influences_of_engines(tmp_path, monkeypatch):
    """Though nothing else is pruned: what is cut off at export was never measured."""
    config = small_config(tmp_path, growth=0.0, prune_at=0.65, validate_every=1, full_encoding=1.0)
    nodes = replace(config.garment_nodes, influences=config.garment_nodes.initial_influences)
    trainer = Trainer(replace(config, garment_nodes=nodes), CPU)
    remaining = spoken(monkeypatch, [5.0, 4.0, 3.0, 2.0, 1.0])
    best = [trainer.best and trainer.best.step for _ in trainer.run(12)]
    assert not remaining
    assert best == [None] * 7 + [8, 9, 10, 11, 12]


def test_the_export_is_the_best_model(tmp_path, monkeypatch):
    """Of two measurements, the first one is better."""
    config = small_config(tmp_path, steps=4, growth=0.0, prune_from=0.0, prune_at=0.0, validate_every=2)
    averages = []

    def energy(validation, drape):
        validation.made_to_measure = validation.strained = 0.0
        averages.append(drape.skinning_weights.detach().clone())
        return float(len(averages))

    monkeypatch.setattr(Validation, "energy", energy)
    trainer = Trainer(config, CPU)
    run(trainer, 4)
    model = best_model(trainer)
    assert model.training["step"] == 2 and model.training["validation_energy_j"] == 1.0
    assert model.bending_octaves == BENDING_OCTAVES
    exported = drape_from_model(model).skinning_weights.detach().sort(dim=1).values
    first, second = (weights.sort(dim=1).values[:, -3:] for weights in averages)
    assert (exported - first).abs().max() < 0.2 * (second - first).abs().max()


def test_patience_ends_a_run(tmp_path, monkeypatch):
    """Two measurements without a better one after that of the third step: it goes on where rates fall, at eight of
    twelve steps, and ends after two more without a better one there."""
    options = {"growth": 0.0, "prune_from": 0.0, "prune_at": 0.0, "validate_every": 1, "full_encoding": 1.0}
    trainer = Trainer(small_config(tmp_path, patience=2, **options), CPU)
    remaining = spoken(monkeypatch, [5.0, 4.0, 3.0, 3.5, 3.5, 2.5, 2.6, 2.7, 1.0])
    assert list(trainer.run(12)) == [1, 2, 3, 4, 8, 9, 10, 11] and trainer.best.step == 9
    assert trainer.settled and remaining == [1.0]
