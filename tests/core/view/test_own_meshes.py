"""Meshes among the garments of the page: fit-garment makes models of them, in processes of their own."""

from __future__ import annotations

import shutil
import signal
from pathlib import Path

import pytest

from physkin_core.model.model_file import MODELS_PATH
from physkin_core.view import own_meshes
from physkin_core.view.own_meshes import OwnMeshes


class Training:
    """In place of `physkin fit-garment`: it writes its model, or ends with a status."""

    started: list = []
    status = None

    def __init__(self, program, **_) -> None:
        self.program, self.pid, self.returncode, self.signals = program, 0, self.status, []
        Training.started.append(self)
        if self.status is None:
            shutil.copy(MODELS_PATH / "tanktop.safetensors", program[program.index("-o") + 1])

    def poll(self):
        return self.returncode

    def send_signal(self, number) -> None:
        self.signals.append(number)

    def wait(self, _) -> None:
        self.returncode = 130


@pytest.fixture(autouse=True)
def no_training(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(own_meshes.subprocess, "Popen", Training)
    monkeypatch.setattr(own_meshes.os, "setpriority", lambda *_: None)
    monkeypatch.setattr(Training, "started", [])


def test_a_mesh_trains_while_its_model_is_worn(capsys):
    """Made on the avatar, in its fabric; other garments stay as they are; at the end it is asked to stop."""
    own = OwnMeshes(["trousers", "clothes/my.OBJ:denim", "skirt:#ff0000"], ["--avatar", "me.glb"])
    assert own.garments == ["trousers", "my.safetensors:denim", "skirt:#ff0000"]
    (training,) = Training.started
    assert training.program[3:] == ["fit-garment", "clothes/my.OBJ", "-o", "my.safetensors", "--avatar", "me.glb"]
    assert "-o my.safetensors --avatar me.glb --resume" in capsys.readouterr().out
    own.close()
    assert training.signals == [signal.SIGINT]


def test_a_model_that_is_there_is_worn_as_it_is(capsys):
    """It may be the work of a night."""
    Path("shawl.safetensors").touch()
    own = OwnMeshes(["shawl.glb"], [])
    assert own.garments == ["shawl.safetensors"] and not Training.started
    assert "physkin fit-garment shawl.glb -o shawl.safetensors --resume" in capsys.readouterr().out


def test_a_mesh_that_is_refused_ends_the_others(monkeypatch):
    """The command itself has said why."""
    OwnMeshes(["first.json"], [])
    Path("first.safetensors").unlink()
    monkeypatch.setattr(Training, "status", 1)
    with pytest.raises(ValueError, match="ball.stl cannot be worn: physkin fit-garment ended with status 1"):
        OwnMeshes(["ball.stl"], [])
