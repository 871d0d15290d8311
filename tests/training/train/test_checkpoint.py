"""Checkpoints: a run that stopped and went on is the run that never stopped, bit for bit; misfits are refused."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pytest
import torch
from training.small_runs import run, small_config

from physkin_training.train.checkpoint import CheckpointError, checkpoint_step
from physkin_training.train.trainer import Trainer

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """The small run to its end without a stop, with checkpoints on the way after 2, 6 and 11 steps."""
    folder = tmp_path_factory.mktemp("run")
    trainer = Trainer(small_config(folder), CPU)
    for stop in (2, 6, 11):
        run(trainer, stop - trainer.step)
        trainer.save(folder / f"step{stop}.pt")
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


@pytest.mark.parametrize("stop", [2, 11])
def test_resumed_run_is_exactly_the_straight_one(straight, stop):
    """Stopped before influences are pruned, and while bodies are encoded from all points, when an average of step 8 is
    kept that is better than the last one."""
    folder, expected = straight
    torch.manual_seed(99)  # whatever was drawn before must not matter
    trainer = Trainer(small_config(folder), CPU)
    trainer.resume(folder / f"step{stop}.pt")
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
    saved = torch.load(folder / "step2.pt")["drape"]
    assert not torch.equal(other.drape.skinning_logits, saved["skinning_logits"])


# --- A new run from another's networks ---


def test_a_new_run_may_start_from_another(straight, tmp_path):
    """Averaged networks and skinning weights as they were; step, optimiser and random numbers as in any new run, and
    another schedule, material and seed. Where it came from goes along, also through the new run's checkpoints."""
    folder, _ = straight
    config = small_config(folder, learning_rate=1e-3, steps=7)
    trainer = Trainer(replace(config, seed=8), CPU)
    trainer.start_from(folder / "step6.pt")
    assert trainer.step == trainer.optimiser.steps == 0
    content = torch.load(folder / "step6.pt")
    saved = content["drape"] | content["average"]
    for drape in (trainer.drape, trainer.averaged):
        same(dict(drape.state_dict()), saved)
    run(trainer, 7)
    assert trainer.step == 7
    assert trainer.started_from["step"] == 6 and trainer.started_from["seed"] == 5
    trainer.save(tmp_path / "second.pt")
    third = Trainer(config, CPU)
    third.start_from(tmp_path / "second.pt")
    assert third.started_from["seed"] == 8 and third.started_from["started_from"] == trainer.started_from
    again = Trainer(replace(config, seed=8), CPU)
    again.resume(tmp_path / "second.pt")
    assert again.started_from == trainer.started_from


def test_a_new_run_starts_from_the_best_that_was_kept(straight):
    """Not from the average where the other run stopped."""
    folder, _ = straight
    trainer = Trainer(small_config(folder), CPU)
    trainer.start_from(folder / "step11.pt")
    content = torch.load(folder / "step11.pt")
    best = content["best"]["parameters"]
    same({name: parameter.data for name, parameter in trainer.drape.named_parameters()}, best)
    assert not torch.equal(content["average"]["skinning_logits"], best["skinning_logits"])
    assert trainer.started_from["step"] == 8 and trainer.best is None


# --- Refusals ---


@pytest.fixture
def copy(straight, tmp_path):
    folder, _ = straight
    return shutil.copy(folder / "step6.pt", tmp_path / "checkpoint.pt")


@pytest.fixture(scope="module")
def other(straight):
    """A trainer of the same configuration that is never given a good checkpoint."""
    return Trainer(small_config(straight[0]), CPU)


def test_other_sizes_and_missing_files_are_refused(straight, tmp_path):
    folder, _ = straight
    config = small_config(folder)
    trainer = Trainer(replace(config, networks=replace(config.networks, pose_hidden=32)), CPU)
    for path in (folder / "step6.pt", tmp_path / "nowhere.pt"):
        with pytest.raises(CheckpointError, match="cannot start from checkpoint"):
            trainer.start_from(path)
    with pytest.raises(CheckpointError, match="nowhere"):
        trainer.resume(tmp_path / "nowhere.pt")


@pytest.mark.parametrize("entry", ["lower", "upper", "garment_heads", "vertices", "node_rest", "node_bone"])
@pytest.mark.parametrize("how", ["resume", "start_from"])
def test_a_checkpoint_of_another_rig_or_garment_is_not_taken_over(other, copy, how, entry):
    """Equal sizes, other numbers: joint limits, body or mesh changed since. The exported model holds the run's own rig,
    so networks must not go on with the checkpoint's."""
    content = torch.load(copy)
    content["drape"][entry] = content["drape"][entry] + 1
    torch.save(content, copy)
    own = other.drape.state_dict()[entry].clone()
    with pytest.raises(CheckpointError, match=entry):
        getattr(other, how)(copy)
    assert torch.equal(other.drape.state_dict()[entry], own)


def test_another_configuration_is_refused_by_its_entry(other, copy):
    config = other.config
    slower = replace(config.optimisation, learning_rate=1e-3)
    try:
        for changes, named in (
            (dict(seed=6), "seed = 5.* 6"),
            (dict(train_bodies=2), "train_bodies = 3.* 2"),
            (dict(name="shirt"), "name = 'band'.* 'shirt'"),
            (dict(optimisation=slower), "learning_rate = 0.002.* 0.001"),
            (dict(networks=replace(config.networks, pose_hidden=32)), "pose_hidden = 24.* 32"),
        ):
            other.config = replace(config, **changes)
            with pytest.raises(CheckpointError, match=named):
                other.resume(copy)
    finally:
        other.config = config


def test_a_damaged_file_is_refused(other, copy):
    """Cut off anywhere (at every 257th of its bytes, and near both ends), or of other bytes."""
    content = copy.read_bytes()
    ends = {*range(0, len(content), len(content) // 257), *range(8), *range(len(content) - 8, len(content))}
    for damaged in (*(content[:end] for end in sorted(ends)), b"\xff" * len(content)):
        copy.write_bytes(damaged)
        with pytest.raises(CheckpointError, match="cannot read checkpoint"):
            other.resume(copy)


def test_a_file_that_would_run_code_is_refused(other, copy, tmp_path):
    class Harmful:
        def __reduce__(self):
            return (open, (str(tmp_path / "made"), "w"))

    torch.save(torch.load(copy) | {"started_from": Harmful()}, copy)
    with pytest.raises(CheckpointError, match="cannot read checkpoint"):
        other.resume(copy)
    assert not (tmp_path / "made").exists()


def without(content, name):
    return {key: value for key, value in content.items() if key != name}


def changed(entry, change):
    """The content of a checkpoint with another entry of tensors."""
    return lambda content: content | {entry: change(content[entry])}


@pytest.mark.parametrize(
    "change",
    [
        lambda content: [],
        lambda content: without(content, "step"),
        lambda content: content | {"step": -1},
        lambda content: content | {"config": None},
        lambda content: content | {"best": {"step": 5}},
        lambda content: content | {"best": {"step": 5, "energy": 1.0, "parameters": {"lower": torch.ones(3)}}},
        changed("drape", lambda t: t | {"skinning_logits": t["skinning_logits"][:-1]}),
        changed("drape", lambda t: t | {"colour": torch.zeros(1)}),
        changed("drape", lambda t: without(t, "node_rest")),
        changed("optimiser", lambda t: t | {"skinning_logits exp_avg": torch.zeros(3)}),
        changed("optimiser", lambda t: without(t, "skinning_logits exp_avg_sq")),
        changed("average", lambda t: {"skinning_logits": t["skinning_logits"]}),
        changed("random", lambda t: {"gpu": t["cpu"]}),
        changed("random", lambda t: {"cpu": t["cpu"][:5].clone()}),
    ],
)
def test_what_does_not_fit_is_refused(other, copy, change):
    """Undamaged files that do not belong together: an entry, a shape, a name too many or too few."""
    torch.save(change(torch.load(copy)), copy)
    with pytest.raises(CheckpointError):
        other.resume(copy)


def test_an_interrupted_save_loses_nothing(straight, copy, monkeypatch):
    """The disk fills up in the middle of writing over an older checkpoint: the older one is still there."""
    _, trainer = straight
    before = copy.read_bytes()

    def failing(content, path):
        path.write_bytes(before[:1000])
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(torch, "save", failing)
        with pytest.raises(OSError, match="no space"):
            trainer.save(copy)
    assert copy.read_bytes() == before
    trainer.save(copy)
    assert checkpoint_step(copy) == 12
    assert [path.name for path in copy.parent.iterdir()] == [copy.name], "nothing is left beside it"
