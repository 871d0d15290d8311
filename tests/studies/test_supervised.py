"""Supervised training: drapes are minima of the energy, are kept between runs, and are what is learnt."""

from __future__ import annotations

import pytest
import torch
import warp as wp
from training.small_runs import small_config

from physkin_studies import supervised
from physkin_studies.supervised import SimulatedDrapes, SupervisedTrainer, simulate_drapes
from physkin_training.train.trainer import Trainer

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    wp.config.quiet = True
    folder = tmp_path_factory.mktemp("run")
    config = small_config(folder, samples=4, full_encoding=1.0, learning_rate=5e-3)
    drapes = simulate_drapes(Trainer(config, CPU), 5, folder / "drapes", batch=3, iterations=20)
    return config, folder, drapes


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """Drapes of three bodies by plain skinning, two centimetres ahead: what is learnt need not be a minimum."""
    wp.config.quiet = True
    unpruned = {"prune_from": 1.0, "prune_at": 1.0}
    config = small_config(tmp_path_factory.mktemp("run"), samples=4, full_encoding=1.0, learning_rate=5e-3, **unpruned)
    trainer = Trainer(config, CPU)
    body, (positions, gravity) = torch.arange(3), trainer.sampler.sample(6, 1.0)
    every = body.repeat_interleave(2)
    skinned, on_bodies = [], trainer.drape.node_positions(trainer.bodies)
    for pair in torch.arange(8).remainder(6).split(4):
        bones = trainer.posed_bodies.pose(positions[pair], every[pair])
        skinned.append(trainer.drape.skin(trainer.drape.posed_nodes(bones, on_bodies[every[pair]])))
    fields = (positions, gravity, torch.cat(skinned)[:6] + torch.tensor([0.02, 0.0, 0.0]))
    positions, gravity, vertices = (values.unflatten(0, (3, 2)) for values in fields)
    return config, None, SimulatedDrapes(positions, gravity, body, vertices, torch.zeros(3, 2), torch.ones(3, 2) > 0)


@pytest.mark.slow
def test_as_many_drapes_a_body_as_a_step_takes(simulated):
    """Five drapes in groups of two make six; they are neither plain skinning nor apart."""
    config, _, drapes = simulated
    assert drapes.positions.shape[:2] == drapes.converged.shape == (3, 2)
    assert len(set(drapes.body.tolist())) == 3
    trainer = Trainer(config, CPU)
    body, on_bodies = drapes.body.repeat_interleave(2), trainer.drape.node_positions(trainer.bodies)
    bones = trainer.posed_bodies.pose(drapes.positions.flatten(0, 1)[:4], body[:4])
    skinned = trainer.drape.skin(trainer.drape.posed_nodes(bones, on_bodies[body[:4]]))
    gravity, minimised = drapes.gravity.flatten(0, 1)[:4], drapes.vertices.flatten(0, 1)[:4]
    energies = [
        trainer.losses(vertices, gravity, trainer.posed_bodies.mesh, trainer.posed_bodies.offset)[1].total
        for vertices in (minimised.contiguous(), skinned)
    ]
    assert (energies[0] < 0.5 * energies[1]).all()


@pytest.mark.slow
def test_stored_drapes_are_not_simulated_again(simulated, monkeypatch):
    config, folder, drapes = simulated
    monkeypatch.setattr(supervised, "_StagedSimulation", None)
    again = simulate_drapes(Trainer(config, CPU), 5, folder / "drapes", batch=3, iterations=20)
    assert torch.equal(again.vertices, drapes.vertices) and torch.equal(again.positions, drapes.positions)


def test_the_distance_falls(made_up):
    """The loss is the distance from the drapes, and training lowers it; the energy chooses no model."""
    config, _, drapes = made_up
    trainer = SupervisedTrainer(config, CPU, drapes)
    losses = []
    compute = trainer.objective
    trainer.objective = lambda *arguments: losses.append(compute(*arguments)) or losses[-1]
    for _ in trainer.run(12):
        pass
    values = [loss.item() for loss in losses]
    assert sum(values[-4:]) < 0.8 * sum(values[:4])
    assert trainer.best is None and trainer.best_drape() is trainer.averaged


def test_a_drape_learnt_by_heart_has_no_loss(made_up):
    """Targets belong to the bodies and poses that were drawn, in order."""
    config, _, drapes = made_up
    trainer = SupervisedTrainer(config, CPU, drapes)
    chosen, positions, gravity, *_ = trainer.draw()
    for index, body in enumerate(chosen.repeat_interleave(2)):
        group = int((drapes.body == body).nonzero())
        place = int((drapes.positions[group] == positions[index]).all(dim=1).nonzero())
        assert torch.equal(trainer._targets[index], drapes.vertices[group, place])
        assert torch.equal(gravity[index], drapes.gravity[group, place])


@pytest.mark.parametrize("count, batch", [(0, 2), (2, 0)])
def test_impossible_counts_are_refused(tmp_path, count, batch):
    with pytest.raises(ValueError, match=f"at least 1, got {count} and {batch}"):
        simulate_drapes(None, count, tmp_path, batch=batch)


def test_drapes_of_another_count_a_body_are_refused(made_up, tmp_path):
    config, _, drapes = made_up
    with pytest.raises(ValueError, match="drapes must be 3 a body, got 2"):
        SupervisedTrainer(small_config(tmp_path, samples=6), CPU, drapes)
