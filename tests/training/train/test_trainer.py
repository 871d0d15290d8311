"""Training: schedules step by step, and a short run on a CPU that lowers the energy of poses it is not trained on."""

from __future__ import annotations

import json
import math
import signal
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the [training] extra")
wp = pytest.importorskip("warp", reason="needs the [training] extra")
pytest.importorskip("potpourri3d", reason="needs the [training] extra")

from training.small_runs import as_toml, small_config  # noqa: E402

from physkin_core import load_garment, load_garment_model  # noqa: E402
from physkin_core.model.garment import vertex_normals  # noqa: E402
from physkin_core.model.hyper_modulator import POINT_COUNT  # noqa: E402
from physkin_training.config import load_config  # noqa: E402
from physkin_training.networks.export import Agreement, drape_from_model  # noqa: E402
from physkin_training.networks.rest_normals import fitted_rest_normals  # noqa: E402
from physkin_training.train import train  # noqa: E402
from physkin_training.train.train import main  # noqa: E402
from physkin_training.train.trainer import TERMS, Trainer  # noqa: E402

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
        tmp_path, steps=100, growth=0.5, warm_up=0.1, final_rate=0.01, prune_from=0.25, prune_at=0.625,
        full_encoding=0.8, initial_contact=0.05, late_reach=0.04,
    )  # fmt: skip
    trainer = Trainer(config, CPU)
    rows, points, reaches, pruned_at = [], [], [], []
    monkeypatch.setattr(trainer.drape, "prune_influences", lambda keep: pruned_at.append((trainer.step, keep)))

    def record():
        rates = [float(group["lr"]) for group in trainer.optimiser.param_groups]
        rows.append((trainer.range.item(), trainer.losses.contact_stiffness.item(), *rates))
        points.append(trainer._encoder_points)
        reaches.append(trainer.losses.reach)

    monkeypatch.setattr(trainer, "_compute_step", record)
    assert list(trainer.run(1000)) == list(range(1, 101)), "no more steps than the configuration has"
    for step, (share, stiffness, network_rate, skinning_rate) in enumerate(rows):
        assert share == pytest.approx(min(1.0, 0.1 * (1 + (18 * step) // 100)), abs=1e-6), step
        assert stiffness == pytest.approx(4e6 * min(1.0, 0.05 + 0.95 * step / 50), rel=1e-4), step
        factor = min(1.0, step / 10) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * step / 100)))
        assert network_rate == pytest.approx(2e-3 * factor, rel=1e-4, abs=1e-9), step
        assert skinning_rate == pytest.approx(1e-2 * factor, rel=1e-4, abs=1e-9), step
    assert pruned_at == [(26, 5), (38, 4), (51, 3)], "one by one from 6"
    assert reaches == [0.1] * 50 + [0.04] * 50
    assert points == [64] * 80 + [POINT_COUNT] * 20


def catch_energies(trainer, monkeypatch):
    """A list that the energies of every step to come are added to."""
    caught = []
    original = trainer.losses.__call__

    class Losses:
        contact_stiffness = trainer.losses.contact_stiffness
        reach = trainer.losses.reach

        def __call__(self, *arguments):
            loss, energies = original(*arguments)
            caught.append(energies)
            return loss, energies

    monkeypatch.setattr(trainer, "losses", Losses())
    return caught


def test_energies_are_means_over_the_steps_since_asked(tmp_path, monkeypatch):
    """Against the energies of each step, caught on their way."""
    trainer = Trainer(small_config(tmp_path), CPU)
    caught = catch_energies(trainer, monkeypatch)
    for count in (3, 2):
        caught.clear()
        for _ in trainer.run(count):
            pass
        means = trainer.mean_energies()
        per_step = [[getattr(energies, term).mean().item() for term in TERMS] for energies in caught]
        assert list(means) == list(TERMS)
        np.testing.assert_allclose(list(means.values()), np.mean(per_step, axis=0), rtol=1e-4)
    assert len(caught) == 2


def test_the_median_is_that_of_the_last_step(tmp_path, monkeypatch):
    """Against the energies of each sample, caught on their way."""
    trainer = Trainer(small_config(tmp_path, samples=5, bodies=1), CPU)
    caught = catch_energies(trainer, monkeypatch)
    for _ in trainer.run(3):
        pass
    energies = caught[-1]
    values = sorted((energies.stretch + energies.collision).tolist())
    assert trainer.median_energy() == pytest.approx(values[2])


@pytest.mark.parametrize("decay", [0.0, 0.5, 0.999])
def test_the_average_follows_the_parameters(tmp_path, decay):
    """Step by step, with a decay that grows from 1/10 to the configuration's; 0 averages nothing."""
    trainer = Trainer(small_config(tmp_path, average=decay), CPU)
    expected = trainer.drape.skinning_logits.detach().double().clone()
    start = expected.clone()
    for step in trainer.run(6):
        share = min(decay, step / (step + 9))
        expected = share * expected + (1 - share) * trainer.drape.skinning_logits.detach().double()
        torch.testing.assert_close(trainer.averaged.skinning_logits.detach().double(), expected, atol=1e-5, rtol=0)
    assert not torch.equal(expected, start)
    assert (trainer.averaged is trainer.drape) == (decay == 0)
    kept = trainer.averaged.skinning_weights > 0
    assert torch.equal(kept, trainer.drape.skinning_weights > 0) and (kept.sum(dim=1) == 3).all()


def test_more_bodies_than_there_are_are_refused(tmp_path):
    with pytest.raises(ValueError, match="train_bodies must be 1 to [0-9]+, got 1000000"):
        Trainer(replace(small_config(tmp_path), train_bodies=1000000), CPU)


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
    keys = (*TERMS, "range", "gradient_norm", "seconds", "median_stretch_and_collision")
    assert all(math.isfinite(row[term]) for row in rows for term in keys)
    assert list((out / "scalars").iterdir())
    model = load_garment_model(out / "band.safetensors")
    assert model.name == "band" and model.influence_nodes.shape[1] == 3
    assert model.training["seed"] == 5 and model.training["optimisation"]["steps"] == 12
    assert model.training["garment"] == "band.obj", "no path of this machine"
    assert (model.training["step"], model.training["validation_energy_j"]) == (
        rows[-1]["best_step"],
        rows[-1]["best_validation_energy"],
    )
    assert "validation_energy" not in rows[0] and rows[1]["validation_energy"] == rows[1]["best_validation_energy"]
    garment = load_garment(tmp_path / "band.obj")
    np.testing.assert_allclose(model.garment.vertices, garment.vertices, atol=1e-6)
    fitted = fitted_rest_normals(drape_from_model(model), model.garment, model.rig)
    np.testing.assert_allclose(model.rest_normals, fitted, atol=0.01)
    assert np.abs(fitted - vertex_normals(garment.vertices, garment.faces)).max() > 0.02


@pytest.mark.parametrize(
    "distances, message",
    [
        ((0.0062, 0.0), "drapes 6.20 mm away from the trained drape, allowed 5 mm"),
        ((0.0, 0.0042), "drapes 4.20 mm away from the same model in torch, allowed 1 mm"),
        ((math.nan, 0.0), "drapes nan mm away"),
    ],
)
def test_an_export_that_drapes_otherwise_is_refused(config_file, tmp_path, monkeypatch, capsys, distances, message):
    remaining = list(distances)
    monkeypatch.setattr(train, "agreement", lambda model, drape: Agreement(remaining.pop(0), 0.0))
    out = tmp_path / "out"
    assert main(["--config", str(config_file), "--output", str(out), "--device", "cpu"]) == 1
    assert message in capsys.readouterr().err
    assert not list(out.glob("*.safetensors"))


def step_then(action, at):
    """A step of the trainer that calls `action` in step `at`."""
    original = Trainer._compute_step

    def step(trainer):
        original(trainer)
        if trainer.step == at - 1:
            action(trainer)

    return step


def test_ctrl_c_saves_an_exact_checkpoint(config_file, tmp_path, monkeypatch, caplog):
    """The step finishes; the run then goes on as if nothing had been."""
    caplog.set_level("INFO")
    common = ["--config", str(config_file), "--device", "cpu", "--output"]
    assert main([*common, str(tmp_path / "straight")]) == 0
    with monkeypatch.context() as context:
        context.setattr(Trainer, "_compute_step", step_then(lambda _: signal.raise_signal(signal.SIGINT), at=5))
        assert main([*common, str(tmp_path / "out")]) == 130
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    checkpoint = tmp_path / "out" / "checkpoint"
    assert json.loads((checkpoint / "state.json").read_text())["step"] == 5
    assert f"stopped at step 5; go on with --resume {checkpoint}" in caplog.text
    assert main([*common, str(tmp_path / "out"), "--resume", str(checkpoint)]) == 0
    first, second = (load_garment_model(tmp_path / run / "band.safetensors").arrays() for run in ("straight", "out"))
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name], err_msg=name)


def spoil_energies(trainer):
    trainer._energy_sum[0] = math.inf


def spoil_gradient(trainer):
    trainer.gradient_norm.fill_(math.nan)


@pytest.mark.parametrize("spoil", [spoil_energies, spoil_gradient])
@pytest.mark.parametrize("arguments, kept", [(["--checkpoint-every", "1e-9"], 8), (["--log-every", "1"], None)])
def test_a_run_that_diverges_keeps_the_good_checkpoint(
    config_file, tmp_path, monkeypatch, capsys, spoil, arguments, kept
):
    """Checkpoints at every step, or none; the ninth step is no longer finite."""
    monkeypatch.setattr(Trainer, "_compute_step", step_then(spoil, at=9))
    common = ["--config", str(config_file), "--device", "cpu", "--output", str(tmp_path / "out")]
    assert main([*common, *arguments]) == 1
    error = capsys.readouterr().err
    assert "error: energies or gradients are not finite at step 9" in error and ("start from it" in error) == bool(kept)
    state = tmp_path / "out" / "checkpoint" / "state.json"
    assert (json.loads(state.read_text())["step"] if state.exists() else None) == kept
    assert not list((tmp_path / "out").glob("*.safetensors"))


def test_the_model_file_tells_what_it_was_started_from(config_file, tmp_path):
    common = ["--config", str(config_file), "--device", "cpu", "--output"]
    assert main([*common, str(tmp_path / "first")]) == 0
    config_file.write_text(config_file.read_text().replace("seed = 5", "seed = 6"))
    assert main([*common, str(tmp_path / "second"), "--start-from", str(tmp_path / "first" / "checkpoint")]) == 0
    training = load_garment_model(tmp_path / "second" / "band.safetensors").training
    assert training["seed"] == 6
    assert training["started_from"]["seed"] == 5 and training["started_from"]["step"] == 12


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--resume", "a", "--start-from", "b"], "not allowed with argument"),
        (["--log-every", "0"], "0 must be at least 1 step"),
        (["--checkpoint-every", "0"], "0 must be above 0 minutes"),
        (["--stop-after", "nan"], "nan must be above 0 minutes"),
    ],
)
def test_impossible_arguments(config_file, tmp_path, capsys, arguments, message):
    with pytest.raises(SystemExit):
        main(["--config", str(config_file), "--output", str(tmp_path / "out"), "--device", "cpu", *arguments])
    assert message in capsys.readouterr().err


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


def state_of(trainer):
    return {name: tensor.clone() for name, tensor in trainer.drape.state_dict().items()}


def test_choosing_the_steps_leaves_the_run_as_it_was(tmp_path):
    """Steps at the late settings prune, draw and move moments; a run after them is bit for bit the one without."""
    config = small_config(tmp_path, full_encoding=1.0, validate_every=6)
    plain = Trainer(config, CPU)
    for _ in plain.run(12):
        pass
    trainer = Trainer(replace(config, optimisation=replace(config.optimisation, minutes=1.0)), CPU)
    rate = trainer.choose_steps(3.0)
    chosen = trainer.config.optimisation.steps
    assert 0.5 * rate * 3.0 < chosen <= rate * 3.0
    trainer.config = replace(trainer.config, optimisation=replace(trainer.config.optimisation, steps=12))
    for _ in trainer.run(12):
        pass
    for (name, expected), tensor in zip(state_of(plain).items(), state_of(trainer).values(), strict=True):
        assert torch.equal(tensor, expected), name
    assert trainer.best.energy == plain.best.energy
    with pytest.raises(ValueError, match="before the first one, not after 12"):
        trainer.choose_steps(3.0)
    with pytest.raises(ValueError, match="too short for a run of 10 steps"):
        Trainer(config, CPU).choose_steps(0.01)


def test_a_resumed_run_keeps_the_steps_that_were_chosen(tmp_path, capsys):
    """The rate is not measured again: another one would be another schedule."""
    config = small_config(tmp_path, full_encoding=1.0, validate_every=100000)
    text = "\n".join(line for line in as_toml(config).splitlines() if not line.startswith("steps"))
    (tmp_path / "run.toml").write_text(text)
    command = ["--config", str(tmp_path / "run.toml"), "--device", "cpu", "--minutes", "0.1", "--log-every", "1"]
    assert main([*command, "--output", str(tmp_path / "first"), "--stop-after", "0.0001"]) == 0
    state = json.loads((tmp_path / "first" / "checkpoint" / "state.json").read_text())
    chosen = state["config"]["optimisation"]["steps"]
    assert state["step"] < chosen != 100000
    resumed = tmp_path / "first" / "checkpoint"
    assert main([*command, "--output", str(tmp_path / "second"), "--resume", str(resumed)]) == 0
    rows = [json.loads(line) for line in (tmp_path / "second" / "losses.jsonl").read_text().splitlines()]
    assert rows[-1]["step"] == chosen
    wrong = ["--config", str(tmp_path / "run.toml"), "--device", "cpu", "--output", str(tmp_path / "third")]
    assert main([*wrong, "--resume", str(resumed)]) == 2
    assert "minutes = 0.1" in capsys.readouterr().err


def test_skinning_weights_may_stay_as_they_start(tmp_path):
    """A skinning rate of 0; influences are pruned all the same."""
    trainer = Trainer(small_config(tmp_path, skinning_rate=0.0), CPU)
    before = trainer.drape.skinning_logits.clone()
    for _ in trainer.run(6):
        pass
    assert torch.equal(trainer.drape.skinning_logits, before)
    assert ((trainer.drape.skinning_weights > 0).sum(dim=1) == 3).all()
