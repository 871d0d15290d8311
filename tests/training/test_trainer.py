"""Training: schedules step by step, and a short run on a CPU that lowers the energy of poses it is not trained on."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the [training] extra")
wp = pytest.importorskip("warp", reason="needs the [training] extra")
pytest.importorskip("potpourri3d", reason="needs the [training] extra")

from training.small_runs import as_toml, small_config  # noqa: E402

from physkin_core import load_garment, load_garment_model  # noqa: E402
from physkin_core.hyper_modulator import POINT_COUNT  # noqa: E402
from physkin_training import trainer as trainer_module  # noqa: E402
from physkin_training.config import load_config  # noqa: E402
from physkin_training.train import main  # noqa: E402
from physkin_training.trainer import TERMS, Trainer  # noqa: E402

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def quiet():
    wp.config.quiet = True


def validation_energy(trainer):
    """Mean stretch, bend and contact energy [J] over fixed bodies and poses at the full range, full contact stiffness.

    The trainer's schedules and random numbers are left as they were.
    """
    losses, samples = trainer.losses, trainer.config.optimisation.samples
    stiffness = losses.contact_stiffness.clone()
    total = 0.0
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(123)
        losses.contact_stiffness.fill_(trainer.config.material.contact_stiffness)
        for _ in range(4):
            index = torch.arange(samples) % len(trainer.bodies)
            positions, gravity = trainer.sampler.sample(samples, 0.5)
            bones = trainer.posed_bodies.pose(positions, index)
            posed = trainer.drape.posed_nodes(bones, trainer.node_positions[index])
            modulation = trainer.drape.networks.hyper_modulator(*trainer.bodies.sample_points(index, 64))
            vertices = trainer.drape(modulation, positions, gravity, posed)
            _, energies = losses(vertices, gravity, trainer.posed_bodies.mesh, trainer.posed_bodies.offset)
            total += (energies.stretch + energies.bend + energies.collision).mean().item() / 4
        losses.contact_stiffness.copy_(stiffness)
    return total


def test_a_short_run_lowers_the_energy_of_poses_it_has_not_seen(tmp_path):
    """Plain skinning at the start; after 150 steps less than three quarters of its energy on a fixed validation set."""
    config = small_config(
        tmp_path, steps=150, samples=8, growth=0.0, full_encoding=1.0, prune_at=0.6, learning_rate=3e-3
    )
    config = replace(config, train_bodies=2)
    trainer = Trainer(config, CPU)
    before = validation_energy(trainer)
    for _ in trainer.run(150):
        assert math.isfinite(trainer.gradient_norm.item())
    after = validation_energy(trainer)
    assert after < 0.75 * before
    weights = trainer.drape.skinning_weights
    assert (weights > 0).sum(dim=1).max() == 3, "influences are pruned"
    assert torch.allclose(weights.sum(dim=1), torch.ones(()))


def test_skinning_weights_and_all_networks_learn(tmp_path):
    """After two steps (the last layers start near zero) no parameter is where it was."""
    trainer = Trainer(small_config(tmp_path), CPU)
    start = {name: parameter.detach().clone() for name, parameter in trainer.drape.named_parameters()}
    for _ in trainer.run(3):
        pass
    for name, parameter in trainer.drape.named_parameters():
        if not name.endswith("pool.bias"):  # a softmax does not see it
            assert not torch.equal(parameter, start[name]), name
    assert torch.equal(trainer.drape.node_rest, torch.as_tensor(trainer.nodes.rest, dtype=torch.float32))


def test_the_seed_decides_the_start(tmp_path):
    config = small_config(tmp_path)
    first, again, other = (Trainer(replace(config, seed=seed), CPU).drape.networks for seed in (5, 5, 6))
    weight = first.pose_modulator.layers[0].weight
    assert torch.equal(weight, again.pose_modulator.layers[0].weight)
    assert not torch.equal(weight, other.pose_modulator.layers[0].weight)


def test_schedules(tmp_path, monkeypatch):
    """Range, contact stiffness, learning rates, pruning and number of body points at every step of a hundred."""
    config = small_config(
        tmp_path, steps=100, growth=0.5, warm_up=0.1, final_rate=0.01, prune_at=0.3, full_encoding=0.8,
        initial_contact=0.05,
    )  # fmt: skip
    trainer = Trainer(config, CPU)
    rows, points, pruned_at = [], [], []
    monkeypatch.setattr(trainer.drape, "prune_influences", lambda keep: pruned_at.append((trainer.step, keep)))

    def record():
        rates = [float(group["lr"]) for group in trainer.optimiser.param_groups]
        rows.append((trainer.range.item(), trainer.losses.contact_stiffness.item(), *rates))
        points.append(trainer._encoder_points)

    monkeypatch.setattr(trainer, "_compute_step", record)
    assert list(trainer.run(1000)) == list(range(1, 101)), "no more steps than the configuration has"
    for step, (share, stiffness, network_rate, skinning_rate) in enumerate(rows):
        assert share == pytest.approx(min(1.0, 0.1 * (1 + (18 * step) // 100)), abs=1e-6), step
        assert stiffness == pytest.approx(4e6 * min(1.0, 0.05 + 0.95 * step / 50), rel=1e-4), step
        factor = min(1.0, step / 10) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * step / 100)))
        assert network_rate == pytest.approx(2e-3 * factor, rel=1e-4, abs=1e-9), step
        assert skinning_rate == pytest.approx(5e-3 * factor, rel=1e-4, abs=1e-9), step
    assert pruned_at == [(30, 3)]
    assert points == [64] * 80 + [POINT_COUNT] * 20


def test_energies_are_means_over_the_steps_since_asked(tmp_path, monkeypatch):
    """Against the energies of each step, caught on their way."""
    trainer = Trainer(small_config(tmp_path), CPU)
    caught = []
    original = trainer.losses.__call__

    class Losses:
        contact_stiffness = trainer.losses.contact_stiffness

        def __call__(self, *arguments):
            result = original(*arguments)
            caught.append([getattr(result[1], term).mean().item() for term in TERMS])
            return result

    monkeypatch.setattr(trainer, "losses", Losses())
    for count in (3, 2):
        caught.clear()
        for _ in trainer.run(count):
            pass
        means = trainer.mean_energies()
        assert list(means) == list(TERMS)
        np.testing.assert_allclose(list(means.values()), np.mean(caught, axis=0), rtol=1e-4)
    assert len(caught) == 2


def test_pruning_again_changes_nothing(tmp_path):
    """A run resumed after pruning prunes once more."""
    trainer = Trainer(small_config(tmp_path), CPU)
    for _ in trainer.run(5):
        pass
    weights = trainer.drape.skinning_weights.detach().clone()
    trainer.drape.prune_influences(3)
    assert torch.equal(trainer.drape.skinning_weights, weights)


def test_too_many_garment_nodes_are_refused(tmp_path):
    config = small_config(tmp_path)
    with pytest.raises(ValueError, match="cannot sample 1000 garment nodes from 286 vertices"):
        Trainer(replace(config, garment_nodes=replace(config.garment_nodes, count=1000)), CPU)


# --- The command ---


@pytest.fixture
def config_file(tmp_path):
    config = small_config(tmp_path)
    path = tmp_path / "band.toml"
    path.write_text(as_toml(config))
    assert load_config(path) == config
    return path


def test_the_command_writes_model_checkpoint_and_scalars(config_file, tmp_path):
    """To the end in two parts: stopped by the clock at the first report, resumed, exported."""
    out = tmp_path / "out"
    common = ["--config", str(config_file), "--output", str(out), "--device", "cpu", "--log-every", "4"]
    assert main([*common, "--stop-after", "1e-9"]) == 0
    assert json.loads((out / "checkpoint" / "state.json").read_text())["step"] == 4
    assert not list(out.glob("*.safetensors")), "no model before the run is finished"
    assert main([*common, "--resume", str(out / "checkpoint")]) == 0
    rows = [json.loads(line) for line in (out / "losses.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [4, 8, 12]
    assert all(math.isfinite(row[term]) for row in rows for term in (*TERMS, "range", "gradient_norm", "seconds"))
    assert list((out / "scalars").iterdir())
    model = load_garment_model(out / "band.safetensors")
    assert model.name == "band" and model.influence_nodes.shape[1] == 3
    assert model.training["seed"] == 5 and model.training["optimisation"]["steps"] == 12
    assert model.training["garment"] == "band.obj", "no path of this machine"
    garment = load_garment(tmp_path / "band.obj")
    np.testing.assert_allclose(model.garment.vertices, garment.vertices, atol=1e-6)


def test_an_export_that_drapes_otherwise_is_an_error(config_file, tmp_path, monkeypatch, capsys):
    from physkin_training import train

    monkeypatch.setattr(train, "agreement", lambda model: 0.0042)
    assert main(["--config", str(config_file), "--output", str(tmp_path / "out"), "--device", "cpu"]) == 1
    assert "4.20 mm away" in capsys.readouterr().err


@pytest.mark.parametrize(
    "spoil, arguments, message",
    [
        (lambda text: text.replace("seed", "sead"), [], "unknown key 'sead'"),
        (lambda text: text.replace("band.obj", "gone.obj"), [], "gone.obj"),
        (lambda text: text, ["--device", "cuda:7"], "device 'cuda:7' is not available"),
        (lambda text: text, ["--device", "abacus"], "unknown device 'abacus'"),
        (lambda text: text, ["--resume", "nowhere"], "cannot read checkpoint nowhere"),
    ],
)
def test_errors_of_the_command_are_one_line(config_file, tmp_path, capsys, spoil, arguments, message):
    config_file.write_text(spoil(config_file.read_text()))
    out = tmp_path / "out"
    common = ["--config", str(config_file), "--output", str(out), "--device", "cpu"]
    assert main([*common, *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error and "Traceback" not in error
    assert not out.exists()


def test_terms_are_those_of_the_losses():
    assert trainer_module.TERMS == ("stretch", "bend", "collision", "gravity")
