"""Checkpoints: a run that stopped and went on is the run that never stopped, bit for bit; misfits are refused."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
import torch
from safetensors.torch import load_file, save_file
from training.small_runs import run, small_config

from physkin_training.train import checkpoint
from physkin_training.train.checkpoint import CheckpointError
from physkin_training.train.trainer import Trainer

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """The small run to its end without a stop, with checkpoints on the way after 2, 6 and 11 steps."""
    folder = tmp_path_factory.mktemp("run")
    trainer = Trainer(small_config(folder), CPU)
    for stop in (2, 6, 11):
        run(trainer, stop - trainer.step)
        trainer.save(folder / f"step{stop}")
    run(trainer, 12)
    return folder, trainer


def same(one, other):
    """Bit for bit, in tensors and nests of them."""
    torch.testing.assert_close(one, other, rtol=0, atol=0)


def state(trainer):
    """All that a run goes on from."""
    best = vars(trainer.best) if trainer.best else {}
    scalars = trainer.range, trainer.losses.collision.stiffness
    networks = dict(trainer.drape.state_dict()), dict(trainer.averaged.state_dict())
    return *networks, list(trainer.optimiser.state.values()), best, scalars


@pytest.mark.parametrize("stop", [2, 6, 11])
def test_resumed_run_is_exactly_the_straight_one(straight, stop):
    """Stopped before influences are pruned, after that, and while bodies are encoded from all points, with an average
    of step 8 kept that is better than the last one."""
    folder, expected = straight
    torch.manual_seed(99)  # whatever was drawn before must not matter
    trainer = Trainer(small_config(folder), CPU)
    trainer.resume(folder / f"step{stop}")
    assert trainer.step == stop
    assert (trainer.best.step if trainer.best else None) == (8 if stop == 11 else None)
    run(trainer, 12)
    assert trainer.step == expected.step == 12
    same(state(trainer), state(expected))


def test_saving_does_not_disturb_the_run(straight):
    """The same without any checkpoint; and another seed is another run."""
    folder, expected = straight
    trainer = Trainer(small_config(folder), CPU)
    run(trainer, 12)
    same(state(trainer), state(expected))
    other = Trainer(replace(small_config(folder), seed=6), CPU)
    run(other, 2)
    saved = load_file(folder / "step2" / "drape.safetensors")
    assert not torch.equal(other.drape.skinning_logits, saved["skinning_logits"])


# --- A new run from another's networks ---


def test_a_new_run_may_start_from_another(straight, tmp_path):
    """Averaged networks and skinning weights as they were; step, optimiser and random numbers as in any new run, and
    another schedule, material and seed. Where it came from goes along, also through the new run's checkpoints."""
    folder, _ = straight
    config = small_config(folder, learning_rate=1e-3, steps=7)
    trainer = Trainer(replace(config, seed=8), CPU)
    trainer.start_from(folder / "step6")
    assert trainer.step == trainer.optimiser.steps == 0
    saved = {k: v for file in ("drape", "average") for k, v in load_file(folder / f"step6/{file}.safetensors").items()}
    for drape in (trainer.drape, trainer.averaged):
        same(dict(drape.state_dict()), saved)
    run(trainer, 7)
    assert trainer.step == 7
    assert trainer.started_from["step"] == 6 and trainer.started_from["seed"] == 5
    trainer.save(tmp_path / "second")
    third = Trainer(config, CPU)
    third.start_from(tmp_path / "second")
    assert third.started_from["seed"] == 8 and third.started_from["started_from"] == trainer.started_from
    again = Trainer(replace(config, seed=8), CPU)
    again.resume(tmp_path / "second")
    assert again.started_from == trainer.started_from


def test_a_new_run_starts_from_the_best_that_was_kept(straight):
    """Not from the average where the other run stopped."""
    folder, _ = straight
    trainer = Trainer(small_config(folder), CPU)
    trainer.start_from(folder / "step11")
    best = load_file(folder / "step11" / "best.safetensors")
    average = load_file(folder / "step11" / "average.safetensors")
    same({name: parameter.data for name, parameter in trainer.drape.named_parameters()}, best)
    assert not torch.equal(average["skinning_logits"], best["skinning_logits"])
    assert trainer.started_from["step"] == 8 and trainer.best is None


def test_other_sizes_and_missing_folders_are_refused(straight, tmp_path):
    folder, _ = straight
    config = small_config(folder)
    trainer = Trainer(replace(config, networks=replace(config.networks, pose_hidden=32)), CPU)
    for path in (folder / "step6", tmp_path / "nowhere"):
        with pytest.raises(CheckpointError, match="cannot start from checkpoint"):
            trainer.start_from(path)
    with pytest.raises(CheckpointError, match="nowhere"):
        trainer.resume(tmp_path / "nowhere")


# --- Refusals ---


@pytest.fixture
def copy(straight, tmp_path):
    folder, _ = straight
    return shutil.copytree(folder / "step6", tmp_path / "checkpoint")


@pytest.fixture(scope="module")
def other(straight):
    """A trainer of the same configuration that is never given a good checkpoint."""
    return Trainer(small_config(straight[0]), CPU)


def resume(straight, path, **changes):
    trainer = Trainer(replace(small_config(straight[0]), **changes), CPU)
    trainer.resume(path)
    return trainer


@pytest.mark.parametrize("entry", ["lower", "upper", "garment_heads", "vertices", "node_rest", "node_bone"])
@pytest.mark.parametrize("how", ["resume", "start_from"])
def test_a_checkpoint_of_another_rig_or_garment_is_not_taken_over(other, copy, how, entry):
    """Equal sizes, other numbers: joint limits, body or mesh changed since. The exported model holds the run's own rig,
    so networks must not go on with the checkpoint's."""
    tensors = load_file(copy / "drape.safetensors")
    tensors[entry] = tensors[entry] + 1
    save_file(tensors, copy / "drape.safetensors")
    own = other.drape.state_dict()[entry].clone()
    with pytest.raises(CheckpointError, match=entry):
        getattr(other, how)(copy)
    assert torch.equal(other.drape.state_dict()[entry], own)


def test_another_configuration_is_refused_by_its_entry(straight, copy):
    config = small_config(straight[0])
    slower = replace(config.optimisation, learning_rate=1e-3)
    for changes, named in (
        (dict(seed=6), "seed = 5.* 6"),
        (dict(train_bodies=2), "train_bodies = 3.* 2"),
        (dict(name="shirt"), "name = 'band'.* 'shirt'"),
        (dict(optimisation=slower), "learning_rate = 0.002.* 0.001"),
        (dict(networks=replace(config.networks, pose_hidden=32)), "pose_hidden = 24.* 32"),
    ):
        with pytest.raises(CheckpointError, match=named):
            resume(straight, copy, **changes)


TENSORS = ("drape", "average", "best", "exp_avg", "exp_avg_sq", "random")
FILES = ("state.json", *(f"{name}.safetensors" for name in TENSORS))


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("damage", ["missing", "empty", "half", "garbage"])
def test_a_damaged_file_is_refused(other, copy, name, damage):
    path = copy / name
    data = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "half": data[: len(data) // 2], "garbage": b"\xff" * len(data)}[damage])
    with pytest.raises(CheckpointError, match="cannot read checkpoint"):
        other.resume(copy)


def test_a_state_without_its_entries_is_refused(other, copy):
    good = json.loads((copy / "state.json").read_text())
    no_step = {key: value for key, value in good.items() if key != "step"}
    for content in ({}, [], {"config": None}, no_step, good | {"best": {"step": 5}}):
        (copy / "state.json").write_text(json.dumps(content))
        with pytest.raises(CheckpointError):
            other.resume(copy)


@pytest.mark.parametrize(
    "file, change",
    [
        ("drape", lambda t: {**t, "skinning_logits": t["skinning_logits"][:-1].clone()}),
        ("drape", lambda t: {**t, "colour": torch.zeros(1)}),
        ("drape", lambda t: {name: tensor for name, tensor in t.items() if name != "node_rest"}),
        ("exp_avg", lambda t: {**t, "skinning_logits": torch.zeros(3)}),
        ("exp_avg_sq", lambda t: {"skinning_logits": t["skinning_logits"]}),
        ("average", lambda t: {"skinning_logits": t["skinning_logits"]}),
        ("best", lambda t: {"skinning_logits": torch.zeros(3)}),
        ("random", lambda t: {"gpu": t["cpu"]}),
        ("random", lambda t: {"cpu": t["cpu"][:5].clone()}),
    ],
)
def test_tensors_that_do_not_fit_are_refused(other, copy, file, change):
    """Undamaged files that do not belong together: another shape, a name too many or too few."""
    save_file(change(load_file(copy / f"{file}.safetensors")), copy / f"{file}.safetensors")
    with pytest.raises(CheckpointError):
        other.resume(copy)


@pytest.mark.parametrize("writes", [0, 4])
def test_an_interrupted_save_loses_nothing(straight, copy, monkeypatch, writes):
    """The disk fills up in the middle of writing over an older checkpoint: the older one is still there."""
    trainer = resume(straight, copy)
    run(trainer, 1)
    written = []

    def failing(tensors, path):
        if len(written) == writes:
            raise OSError("no space left on device")
        written.append(path)
        save_file(tensors, path)

    monkeypatch.setattr(checkpoint, "save_file", failing)
    with pytest.raises(OSError, match="no space"):
        trainer.save(copy)
    assert resume(straight, copy).step == 6
    monkeypatch.undo()
    trainer.save(copy)
    assert resume(straight, copy).step == 7
    assert [path.name for path in copy.parent.iterdir()] == [copy.name], "nothing is left beside it"


def test_a_save_killed_while_swapping_loses_nothing(straight, copy):
    """Between moving the older checkpoint aside and moving the new one in its place."""
    copy.rename(copy.with_name("checkpoint.previous"))
    assert resume(straight, copy).step == 6


def test_other_files_are_not_swept_away(straight, copy):
    (copy / "notes.txt").write_text("mine")
    with pytest.raises(CheckpointError, match="notes.txt"):
        resume(straight, copy).save(copy)
    assert (copy / "notes.txt").exists()
