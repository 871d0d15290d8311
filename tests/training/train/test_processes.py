"""Two processes under torchrun, by gloo: the gradient of the union of their samples, one model, one writer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

if not torch.distributed.is_available():
    pytest.skip("this torch has no distributed package", allow_module_level=True)

from safetensors.torch import load_file
from training.small_runs import small_config

from physkin_core import load_garment_model
from physkin_training.config import as_toml
from physkin_training.train import processes
from physkin_training.train.processes import Processes, join
from physkin_training.train.train import main
from physkin_training.train.trainer import Trainer
from training import two_processes

TESTS = Path(__file__).parents[2]
CPU = torch.device("cpu")


def torchrun(*arguments):
    """Two processes of one thread each."""
    environment = os.environ | {"PYTHONPATH": str(TESTS), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    result = subprocess.run(
        [*command, *map(str, arguments)], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr[-3000:]
    return result


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files of `two_processes.py`."""
    path = tmp_path_factory.mktemp("two")
    two_processes.config(path)
    torchrun(TESTS / "training" / "two_processes.py", path)
    return path


def reports(folder, name):
    return [load_file(folder / f"{name}{rank}.safetensors") for rank in range(2)]


@pytest.mark.slow
def test_processes_draw_different_samples(folder):
    one, other = reports(folder, "drawn")
    for index in ("1", "3"):  # positions and surface points; body and gravity may be the same by chance
        assert one[index].shape == other[index].shape and not torch.equal(one[index], other[index])
    assert len(one["0"]) == 2 and len(one["1"]) == 4, "half of the configuration's four bodies and eight samples"


@pytest.mark.slow
def test_the_gradient_is_that_of_one_process_on_all_samples(folder, monkeypatch):
    """One process that starts from their checkpoint and is given both draws takes the same step."""
    monkeypatch.setattr("physkin_training.train.trainer.LARGEST_GRADIENT", 1e9)
    trainer = Trainer(two_processes.config(folder), CPU)
    trainer.resume(folder / "start")
    drawn = reports(folder, "drawn")
    trainer.draw = lambda: tuple(torch.cat([part[str(index)] for part in drawn]) for index in range(5))
    list(trainer.run(1))
    one, other = reports(folder, "gradient")
    for name, parameter in trainer.drape.named_parameters():
        assert torch.equal(one[name], other[name]), name
        scale = parameter.grad.abs().max().item()
        torch.testing.assert_close(one[name], parameter.grad, rtol=1e-3, atol=1e-4 * scale + 1e-9, msg=name)
    energies = torch.tensor(list(trainer.mean_energies().values()))
    for part in reports(folder, "energies"):
        torch.testing.assert_close(part["mean"], energies, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_both_have_the_same_model_stopped_or_not(folder):
    """After twelve steps, with influences pruned on the way; a flag of one is a flag of all."""
    start = load_file(folder / "start" / "drape.safetensors")
    straight, _ = reports(folder, "end")
    for name, expected in (("end", straight), ("resumed", straight), ("best", reports(folder, "best")[0])):
        for part in reports(folder, name):
            assert part.keys() == expected.keys()
            for key, tensor in part.items():
                assert torch.equal(tensor, expected[key]), (name, key)
            assert not torch.equal(part["skinning_logits"], start["skinning_logits"])
    for part in reports(folder, "flags"):
        assert part["any"].tolist() == [False, True, True]


@pytest.mark.slow
def test_one_process_goes_on_from_two(folder):
    """With the same networks, and samples that its number, seed and step decide."""
    first, second = [], []
    for caught in (first, second):
        trainer = Trainer(two_processes.config(folder), CPU)
        trainer.resume(folder / "middle")
        saved = load_file(folder / "middle" / "drape.safetensors")
        assert all(torch.equal(tensor, saved[name]) for name, tensor in trainer.drape.state_dict().items())
        caught += list(trainer.run(1)), trainer.drape.skinning_logits.detach()
    assert first[0] == second[0] == [7]
    assert torch.equal(first[1], second[1])


@pytest.mark.slow
def test_the_command_in_two_processes_and_on_in_one(tmp_path):
    """Stopped at the first report, gone on by one process to the end; nothing is written twice."""
    config = tmp_path / "band.toml"
    config.write_text(as_toml(small_config(tmp_path, steps=4, full_encoding=1.0, bodies=4, samples=8)))
    out = tmp_path / "out"
    common = ["--config", str(config), "--output", str(out), "--device", "cpu", "--log-every", "2"]
    result = torchrun("-m", "physkin_training", *common, "--stop-after", "1e-9")
    assert result.stderr.count("stopped at step 2") == 1
    assert main([*common, "--resume", str(out / "checkpoint")]) == 0
    rows = [json.loads(line) for line in (out / "losses.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [2, 4]
    assert len(list((out / "scalars").iterdir())) == 2, "one file of scalars a start"
    assert load_garment_model(out / "band.safetensors").training["step"] == rows[-1]["best_step"]


def test_a_process_that_is_alone_sends_nothing():
    assert join("cpu") == (Processes(rank=0, count=1), CPU)
    tensor = torch.arange(3.0)
    alone = Processes()
    alone.average([tensor])
    alone.broadcast([tensor])
    assert tensor.tolist() == [0, 1, 2] and alone.gather(tensor).tolist() == [[0, 1, 2]]
    assert alone.any(True, False) == [True, False]


def test_bodies_that_cannot_be_shared_out_are_refused(tmp_path):
    with pytest.raises(ValueError, match="3 processes, got 2"):
        Trainer(small_config(tmp_path), CPU, processes=Processes(0, 3))


@pytest.mark.parametrize(
    "device, message",
    [
        ("cuda:0", "'cuda:0' .* 2 processes"),
        ("cuda", "2 processes .* 1"),
        ("abacus", "'abacus'"),
    ],
)
def test_devices_that_cannot_be_shared_out_are_refused(monkeypatch, device, message):
    """As torchrun would start it on a machine of one GPU."""
    for name, value in (("WORLD_SIZE", "2"), ("LOCAL_WORLD_SIZE", "2"), ("LOCAL_RANK", "1")):
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(processes.dist, "is_torchelastic_launched", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(ValueError, match=message):
        join(device)
