"""The `physkin` command."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import physkin_core
from physkin_core import Draper, cli, load_avatar, load_motion

AVATAR = physkin_core.BUNDLED_AVATAR


def test_info(model_path, capsys):
    """Name, sizes, material and rig of a model, without ROS or torch."""
    assert cli.main(["info", str(model_path)]) == 0
    output = capsys.readouterr().out
    assert "not learnt: fit 0 only" in output
    assert "vest" in output and "16, 4 influences a vertex" in output and "youngs_modulus" in output


def test_drape_writes_body_and_garment(model_path, garment_model, tmp_path, capsys):
    """The OBJ's second object is what the core gives for that frame, gravity included."""
    path = tmp_path / "out.obj"
    assert cli.main(["drape", str(model_path), str(AVATAR), "--motion", "walk", "--frame", "9", "-o", str(path)]) == 0
    avatar = load_avatar(AVATAR, garment_model.rig)
    motion = load_motion("walk")
    assert motion.joint_names == garment_model.rig.joint_names
    expected = Draper(garment_model, avatar).drape(motion.positions[9], motion.gravity[9])
    body, garment = (part.splitlines()[1:] for part in path.read_text().split("o ")[1:])
    vertices = np.array([line.split()[1:] for line in garment if line.startswith("v")], dtype=float)
    np.testing.assert_allclose(vertices, expected[:, :3], atol=1e-6)
    faces = np.array([line.split()[1:] for line in garment if line.startswith("f")], dtype=int)
    assert faces.min() > len(avatar.vertices) and faces.max() <= len(avatar.vertices) + len(vertices)
    assert sum(line.startswith("v") for line in body) == len(avatar.vertices)


def test_drape_draws(model_path, tmp_path):
    """A picture instead of a mesh."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    path = tmp_path / "out.png"
    assert cli.main(["drape", str(model_path), str(AVATAR), "-o", str(path)]) == 0
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["drape", "{model}", "{avatar}", "--fit", "1", "-o", "{tmp}/out.obj"], "has not learnt to be made to measure"),
        (["info", "nosuch"], "no garment model 'nosuch'"),
        (["info", "{tmp}/nosuch.safetensors"], "cannot read garment model"),
        (["drape", "{model}", "nosuch.glb", "-o", "out.obj"], "no such file"),
        (["drape", "{model}", "{avatar}", "--motion", "nosuch", "-o", "out.obj"], "no bundled motion 'nosuch'"),
        (["drape", "{model}", "{avatar}", "--frame", "-1", "-o", "out.obj"], "has frames 0 to"),
        (["drape", "{model}", "{avatar}", "-o", "out.fbx"], "must end in .obj or .png"),
        (["drape", "{model}", "{avatar}", "--backend", "gpu", "-o", "out.obj"], "unknown backend 'gpu'"),
        (["drape", "{model}", "{avatar}", "-o", "{tmp}/none/out.obj"], "No such file or directory"),
        (["bind", "{avatar}", "--push-out", "-o", "{tmp}/x"], "push-out was removed"),
    ],
)
def test_errors_are_one_line(arguments, reason, model_path, tmp_path, capsys):
    """Exit status 2 and a sentence on stderr."""
    filled = [word.format(model=model_path, avatar=AVATAR, tmp=tmp_path) for word in arguments]
    assert cli.main(filled) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith("error: ") and reason in lines[-1]


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        ("node", "rclpy", "ros"),
        ("replay", "rosbags", "replay"),
        ("replay", "apsw", "replay"),
        ("train", "torch", "training"),
        ("train", "physkin_training", "training"),
    ],
)
def test_missing_extra_is_named(command, package, extra, monkeypatch, capsys):
    """One line says what to install."""
    hidden = ("physkin_ros", "physkin_training", package)
    for name in [name for name in sys.modules if name.split(".")[0] in hidden]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)  # makes `import` raise ModuleNotFoundError
    assert cli.main([command]) == 2
    assert f"physkin {command} needs: pip install 'physkin[{extra}]'" in capsys.readouterr().err


def test_arguments_reach_the_subcommand(monkeypatch):
    """They are handed on as they are, those of ROS too."""
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
    given = []
    monkeypatch.setattr("physkin_ros.node.node_process.main", given.extend)
    assert cli.main(["node", "--ros-args", "-p", "model:=dress"]) == 0
    assert given == ["--ros-args", "-p", "model:=dress"]


def test_usage_names_every_command(capsys):
    """As does the error for a command that does not exist."""
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    output = capsys.readouterr().out
    assert all(name in output for name in (*cli.FORWARDED, "drape", "info"))
    with pytest.raises(SystemExit, match="2"):
        cli.main(["dance"])
