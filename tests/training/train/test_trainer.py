"""Training: schedules step by step, and a short run on a CPU that lowers the energy of poses it is not trained on."""

from __future__ import annotations

import json
import math
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from random_models import random_sway_network
from training.small_runs import run, small_config, train_command

from physkin_core import load_body_model, load_garment, load_garment_model
from physkin_core.cli import main
from physkin_core.model.garment import vertex_normals
from physkin_core.model.hyper_modulator import POINT_COUNT
from physkin_training.config import as_toml, load_config
from physkin_training.networks.export import drape_from_model
from physkin_training.networks.rest_normals import fitted_rest_normals
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.sway.modules import HIDDEN, LAST, OSCILLATORS, READ
from physkin_training.train import schedule, validation
from physkin_training.train import trainer as trainer_module
from physkin_training.train.checkpoint import checkpoint_step
from physkin_training.train.run import best_model, trained_model
from physkin_training.train.trainer import TERMS, Trainer, TrainingDiverged

CPU = torch.device("cpu")


def strained(trainer):
    """Energy [J] of the averaged drape on the validation's poses, without gravity."""
    trainer.validation.energy(trainer.averaged)
    return trainer.validation.strained


def test_a_short_run_lowers_the_energy_of_poses_it_has_not_seen(tmp_path, monkeypatch):
    """Plain skinning at the start; after 40 steps less than three quarters of its energy on the validation's poses."""
    monkeypatch.setattr(schedule, "AVERAGE_DECAY", 0.0)
    monkeypatch.setattr(validation, "HEAVY_ENERGY", 1e3)  # heavy poses count in full
    monkeypatch.setattr(trainer_module, "NORMALISING_POSES", 2048)  # of few, the energy falls less
    config = small_config(
        tmp_path, steps=40, samples=4, growth=0.0, full_encoding=1.0, prune_at=0.6, learning_rate=8e-3
    )
    trainer = Trainer(replace(config, train_bodies=2), CPU)
    before = strained(trainer)
    for _ in trainer.run(39):
        assert math.isfinite(trainer.gradient_norm.item())
    assert strained(trainer) < 0.75 * before
    weights = trainer.drape.skinning_weights
    assert (weights > 0).sum(dim=1).max() == 3, "influences are pruned"
    assert torch.allclose(weights.sum(dim=1), torch.ones(()))


@pytest.mark.parametrize("skinning_rate", [1e-2, 0.0])
def test_skinning_weights_and_all_networks_learn(tmp_path, skinning_rate):
    """After two steps (the last layers start near zero) no parameter is where it was; a rate of 0 leaves skinning
    weights as they start, but for pruning."""
    trainer = Trainer(small_config(tmp_path, skinning_rate=skinning_rate), CPU)
    start = {name: parameter.detach().clone() for name, parameter in trainer.drape.named_parameters()}
    run(trainer, 5)
    for name, parameter in trainer.drape.named_parameters():
        if not name.endswith("pool.bias"):  # a softmax does not see it
            stays = name in ("skinning_logits", "engine_logits") and skinning_rate == 0
            assert torch.equal(parameter, start[name]) == stays, name
    assert torch.equal(trainer.drape.node_rest, torch.as_tensor(trainer.nodes.rest, dtype=torch.float32))
    weights = trainer.drape.skinning_weights.detach().clone()
    assert ((weights > 0).sum(dim=1) == 3).all()
    assert ((trainer.drape.engine_weights > 0).sum(dim=1) == 2).all()
    trainer.drape.prune_influences(3)
    assert torch.equal(trainer.drape.skinning_weights, weights), "as a resumed run does"


def test_other_bodies_may_be_trained_on(tmp_path):
    body_model = load_body_model()
    others = replace(body_model, train_bodies=body_model.held_out_bodies[:2])
    trainer = Trainer(replace(small_config(tmp_path), train_bodies=2), CPU, body_model=others)
    np.testing.assert_allclose(trainer.bodies.vertices[1], body_model.vertices(others.train_bodies[1]), atol=1e-5)


def test_schedules(tmp_path, monkeypatch):
    """Range, contact stiffness, learning rates, pruning and number of body points at every step of a hundred."""
    config = small_config(
        tmp_path, steps=100, growth=0.5, warm_up=0.1, prune_from=0.25, prune_at=0.625, full_encoding=0.8,
        validate_every=1000,
    )  # fmt: skip
    trainer = Trainer(config, CPU)
    rows, points, reaches, pruned_at = [], [], [], []
    monkeypatch.setattr(trainer.drape, "prune_influences", lambda keep: pruned_at.append((trainer.step, keep)))

    def record():
        *networks, skinning = (float(group["lr"]) for group in trainer.optimiser.param_groups)
        assert len(set(networks)) == 1
        rows.append((trainer.range.item(), trainer.losses.collision.stiffness.item(), networks[0], skinning))
        points.append(trainer.draw()[3].shape[1])
        reaches.append(trainer.losses.collision.reach)

    monkeypatch.setattr(trainer, "take_step", record)
    assert list(trainer.run(1000)) == list(range(1, 101)), "no more steps than the configuration has"
    for step, (share, stiffness, network_rate, skinning_rate) in enumerate(rows):
        assert share == pytest.approx(min(1.0, 0.1 * (1 + (18 * step) // 100)), abs=1e-6), step
        assert stiffness == pytest.approx(4e6 * min(1.0, 0.1 + 0.9 * step / 50), rel=1e-4), step
        factor = min(1.0, step / 10) * (0.005 + 0.995 * 0.5 * (1 + math.cos(math.pi * step / 100)))
        assert network_rate == pytest.approx(2e-3 * factor, rel=1e-4, abs=1e-9), step
        assert skinning_rate == pytest.approx(1e-2 * factor, rel=1e-4, abs=1e-9), step
    assert pruned_at == [(26, 5), (38, 4), (51, 3)], "one by one from 6"
    assert reaches == [0.1] * 50 + [0.05] * 50
    assert points == [64] * 80 + [POINT_COUNT] * 20
    trainer = Trainer(small_config(tmp_path, growth=0.0, prune_from=0.0, prune_at=0.0), CPU)
    next(trainer.run(1))
    assert trainer.losses.collision.reach == 0.05, "late at once without growth"


def test_reports_are_means_over_the_steps_and_the_median_of_the_last(tmp_path, monkeypatch):
    """Against the energies of each step, caught on their way."""
    trainer, caught, original = Trainer(small_config(tmp_path, samples=6, bodies=2), CPU), [], PhysicsLosses.__call__

    def catch(*arguments):
        loss, energies = original(*arguments)
        caught.append(energies)
        return loss, energies

    monkeypatch.setattr(PhysicsLosses, "__call__", catch)
    for count in (3, 2):
        caught.clear()
        run(trainer, count)
        means = trainer.mean_energies()
        per_step = [[getattr(energies, term).mean().item() for term in TERMS] for energies in caught]
        assert list(means) == list(TERMS) and len(caught) == count
        np.testing.assert_allclose(list(means.values()), np.mean(per_step, axis=0), rtol=1e-4)
        assert trainer.median_energy() == pytest.approx(sorted((caught[-1].stretch + caught[-1].collision).tolist())[2])


@pytest.mark.parametrize("decay", [0.5, 0.999])
def test_the_average_follows_the_parameters(tmp_path, decay, monkeypatch):
    """Step by step, with a decay that grows from 1/10 to its last value."""
    monkeypatch.setattr(schedule, "AVERAGE_DECAY", decay)
    trainer = Trainer(small_config(tmp_path), CPU)
    expected = trainer.drape.skinning_logits.detach().double().clone()
    start = expected.clone()
    for step in trainer.run(6):
        share = min(decay, step / (step + 9))
        expected = share * expected + (1 - share) * trainer.drape.skinning_logits.detach().double()
        torch.testing.assert_close(trainer.averaged.skinning_logits.detach().double(), expected, atol=1e-5, rtol=0)
    assert not torch.equal(expected, start)
    kept = trainer.averaged.skinning_weights > 0
    assert torch.equal(kept, trainer.drape.skinning_weights > 0) and (kept.sum(dim=1) == 3).all()


def test_impossible_runs_are_refused(tmp_path):
    config = small_config(tmp_path)
    for wrong, named in (
        (replace(config, train_bodies=1000000), "train_bodies must be 1 to [0-9]+, got 1000000"),
        (replace(config, garment_nodes=replace(config.garment_nodes, count=1000)), "1000 garment nodes from 286"),
        (small_config(tmp_path, bodies=1), "bodies must be at least 2"),
    ):
        with pytest.raises(ValueError, match=named):
            Trainer(wrong, CPU)


# --- The command ---


@pytest.fixture
def config_file(tmp_path):
    config = small_config(tmp_path)
    path = tmp_path / "band.toml"
    path.write_text(as_toml(config))
    assert load_config(path) == config
    return path


def test_the_command_writes_model_checkpoint_and_scalars(finished_run):
    out = finished_run / "out"
    assert checkpoint_step(out / "checkpoint.pt") == 12
    rows = [json.loads(line) for line in (out / "losses.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(1, 13))
    keys = (*TERMS, "range", "gradient_norm", "seconds", "median_stretch_and_collision")
    assert all(math.isfinite(row[term]) for row in rows for term in keys)
    assert list((out / "scalars").iterdir())
    model = load_garment_model(out / "band.safetensors")
    assert model.name == "band" and model.influence_nodes.shape[1] == 3
    assert model.training["seed"] == 5 and model.training["optimisation"]["steps"] == 12
    assert model.training["garment"] == "band.obj", "no path of this machine"
    best = model.training["step"], model.training["validation_energy_j"]
    assert best == (rows[-1]["best_step"], rows[-1]["best_validation_energy"])
    assert "validation_energy" not in rows[6] and rows[7]["validation_energy"] == rows[7]["best_validation_energy"]
    garment = load_garment(finished_run / "band.obj")
    np.testing.assert_allclose(model.garment.vertices, garment.vertices, atol=2e-6)
    fitted = fitted_rest_normals(drape_from_model(model), model.garment, model.rig)
    np.testing.assert_allclose(model.rest_normals, fitted, atol=0.01)
    assert np.abs(fitted - vertex_normals(garment.vertices, garment.faces)).max() > 0.02


def step_then(action, at):
    """A step of the trainer that calls `action` after step `at`."""
    original = Trainer.take_step

    def step(trainer):
        original(trainer)
        if trainer.step == at - 1:
            action()

    return step


def spoilt(trainer, vertices, gravity, original, what):
    """The ninth step's objective: its energies are not finite, or only its gradient is not."""
    if trainer.step < 8:
        return original(trainer, vertices, gravity)
    if what == "energies":
        original(trainer, vertices * math.nan, gravity)
        return 0 * vertices.sum()
    return original(trainer, vertices, gravity) + math.nan * vertices.sum()


@pytest.mark.parametrize(("what", "kept"), [("energies", 8), ("gradient", 8), ("gradient", None)])
def test_a_run_that_diverges_keeps_the_good_checkpoint(tmp_path, monkeypatch, what, kept):
    """Checkpoints at every step, or none; the ninth step is no longer finite."""
    original = Trainer.objective
    monkeypatch.setattr(Trainer, "objective", lambda trainer, *given: spoilt(trainer, *given, original, what))
    trainer, every = Trainer(small_config(tmp_path), CPU), 1e9 if kept is None else 0.0
    with pytest.raises(TrainingDiverged, match="not finite at step 9") as diverged:
        trained_model(trainer, tmp_path / "out", tmp_path / "band.safetensors", checkpoint_every=every)
    assert ("start from it" in str(diverged.value)) == bool(kept)
    assert checkpoint_step(tmp_path / "out" / "checkpoint.pt") == kept
    assert not list(tmp_path.glob("*.safetensors"))


def test_the_model_says_what_it_was_started_from(finished_run, tmp_path):
    trainer = Trainer(replace(small_config(tmp_path), seed=6), CPU)
    trainer.start_from(finished_run / "out" / "checkpoint.pt")
    training = best_model(trainer).training
    assert training["seed"] == 6 and training["started_from"]["seed"] == 5
    first = load_garment_model(finished_run / "out" / "band.safetensors").training
    assert training["started_from"]["step"] == first["step"]


def test_what_a_run_began_with_is_not_shown_again(finished_run, tmp_path, monkeypatch, unfitted_normals):
    """A run from a model is measured before its first step; the next measurement is that of its end."""
    written, finished = [], [0]
    monkeypatch.setattr("physkin_training.train.run.SHOWN_EVERY", -1.0)
    monkeypatch.setattr(
        "physkin_training.train.run.save_garment_model", lambda _, path: written.append((path.name, finished[-1]))
    )
    run = Trainer.run
    monkeypatch.setattr(
        Trainer, "run", lambda self, steps: (finished.append(step) or step for step in run(self, steps))
    )
    config = small_config(tmp_path, steps=3)
    at_once = replace(config.optimisation, growth=0.0, prune_from=0.0, prune_at=0.0, validate_every=100)
    start = load_garment_model(finished_run / "out" / "band.safetensors")
    config = replace(config, optimisation=at_once)
    trained_model(Trainer(config, CPU, start=start), tmp_path, tmp_path / "shown.safetensors", shown=True)
    assert finished == [0, 1, 2, 3] and set(written) == {("shown.safetensors", 3)}


def test_a_run_keeps_the_sway_of_what_it_began_with(finished_run, tmp_path):
    model = load_garment_model(finished_run / "out" / "band.safetensors")
    modulation = len(model.hyper_modulator["output.bias"])
    sizes = {"joints": 12, "states": OSCILLATORS, "widths": (HIDDEN, READ, LAST), "code": 12}
    given = np.random.default_rng(0), len(model.rig.dofs), len(model.node_rest)
    sway = random_sway_network(*given, modulation=modulation, **sizes)
    start = replace(model, sway=sway)
    kept = best_model(Trainer(small_config(tmp_path), CPU, start=start)).sway
    assert all(np.array_equal(ours, theirs) for ours, theirs in zip(kept.rates, start.sway.rates))
    assert kept.code_directions.shape == start.sway.code_directions.shape


def test_an_export_that_drapes_otherwise_is_refused(finished_run, tmp_path, monkeypatch, capsys, unfitted_normals):
    """After it was rounded as finely as can be."""
    tried = []
    monkeypatch.setattr("physkin_training.networks.export.EXPORT_TOLERANCE", 1e-9)
    monkeypatch.setattr(
        "physkin_training.train.run.rounded_model",
        lambda model, *, device, finely=False: tried.append(finely) or model,
    )
    resumed = "--resume", finished_run / "out" / "checkpoint.pt"
    assert main(train_command(finished_run, *resumed, out=tmp_path)) == 1
    assert tried == [False, True]
    assert "allowed 1e-06 mm" in capsys.readouterr().err and not list(tmp_path.glob("*.safetensors"))
    assert (tmp_path / "band.unchecked").exists()


@pytest.mark.parametrize(
    "arguments, named", [(["--resume", "a", "--start-from", "b"], "--start-from"), (["--minutes", "inf"], "inf")]
)
def test_impossible_arguments(config_file, tmp_path, capsys, arguments, named):
    with pytest.raises(SystemExit):
        main(train_command(tmp_path, *arguments))
    assert named in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    "spoil, arguments, named",
    [
        (lambda text: text.replace("seed", "sead"), [], "'sead'"),
        (lambda text: text.replace("band.obj", "gone.obj"), [], "gone.obj"),
        (lambda text: text, ["--device", "cuda:7"], "'cuda:7'"),
        (lambda text: text, ["--device", "abacus"], "'abacus'"),
        (lambda text: text, ["--resume", "nowhere"], "nowhere"),
    ],
)
def test_errors_of_the_command_are_one_line(config_file, tmp_path, capsys, spoil, arguments, named):
    config_file.write_text(spoil(config_file.read_text()))
    assert main(train_command(tmp_path, *arguments)) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and named in error and len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_the_number_of_steps_is_chosen_by_timing_the_first(tmp_path, monkeypatch):
    """They count: of a second each, in 60 s three are for warming up and three are timed, over 2 s or a little more."""
    now = [0.0]

    def take_step(_):
        now[0] += 1.0

    monkeypatch.setattr(Trainer, "take_step", take_step)
    trainer = Trainer(small_config(tmp_path, full_encoding=1.0), CPU)
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    assert trainer.choose_steps(60.0) == pytest.approx(1.0)
    assert trainer.step == 6 and trainer.config.optimisation.steps == 60
    with pytest.raises(ValueError, match="not after 6"):
        trainer.choose_steps(3.0)
    with pytest.raises(ValueError, match="too short for a run of 10 steps"):
        Trainer(small_config(tmp_path), CPU).choose_steps(0.001)


def test_a_run_that_ctrl_c_ends_is_resumed_with_the_steps_that_were_chosen(
    tmp_path, capsys, monkeypatch, unfitted_normals
):
    """The running step is finished and saved. The rate is not measured again: another one would be another schedule."""

    def choose(trainer, seconds):
        assert seconds == pytest.approx(6.0)
        trainer.set_steps(7)
        return 1.0

    text = as_toml(small_config(tmp_path)).splitlines()
    (tmp_path / "band.toml").write_text("\n".join(line for line in text if not line.startswith("steps")))
    command = train_command(tmp_path, "--minutes", "0.1")
    with monkeypatch.context() as context:
        context.setattr(Trainer, "choose_steps", choose)
        context.setattr(Trainer, "take_step", step_then(lambda: signal.raise_signal(signal.SIGINT), at=2))
        assert main(command) == 130
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert checkpoint_step(tmp_path / "out" / "checkpoint.pt") == 2
    monkeypatch.setattr(Trainer, "choose_steps", None)
    resumed = ["--resume", str(tmp_path / "out" / "checkpoint.pt")]
    assert main([*command, *resumed]) == 0
    rows = [json.loads(line) for line in (tmp_path / "out" / "losses.jsonl").read_text().splitlines()]
    assert rows[-1]["step"] == 7
    assert main([*train_command(tmp_path, out="second"), *resumed]) == 2
    assert "steps = 7" in capsys.readouterr().err


def test_an_eighth_of_the_samples_is_skinned_for_engines(tmp_path):
    """Of each body the last poses, one at least; all others as ever, each by its own rest shape."""
    trainer = Trainer(small_config(tmp_path, samples=32, bodies=2), CPU)
    run(trainer, 5)  # both sets are pruned by then, to different influences
    worn = trainer.fits.worn(torch.arange(32) // 16, torch.arange(32) >= 16)
    nodes = torch.eye(4)[:3] + 0.1 * torch.randn(32, 12, 3, 4)
    with torch.no_grad():
        skinned = trainer.skinned(nodes, worn.rest)
        expected = trainer.drape.skin(nodes, worn.rest)
        for_engines = trainer.drape.skin(nodes, worn.rest, for_engines=True)
    few = torch.arange(32) % 16 >= 14
    torch.testing.assert_close(skinned[~few], expected[~few], atol=1e-6, rtol=0)
    torch.testing.assert_close(skinned[few], for_engines[few], atol=1e-6, rtol=0)
    assert (skinned[few] - expected[few]).abs().amax(dim=(1, 2)).min() > 1e-3
