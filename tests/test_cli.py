"""The `physkin` command."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from random_models import random_sway_network

import physkin_core
from physkin_core import Draper, LimbSeparator, Outfit, cli, load_avatar, load_motion, save_garment_model
from physkin_core.extras import install_command
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.render import filming

AVATAR = physkin_core.BUNDLED_AVATAR


def test_info(model_path, garment_model, tmp_path, capsys):
    """Name, sizes, material and rig of a model, without ROS or torch."""
    assert cli.main(["info", str(model_path)]) == 0
    output = capsys.readouterr().out
    assert "none: it has no sway network" in output
    assert "vest" in output and "16, 4 influences a vertex" in output and "youngs_modulus" in output
    modulation = 2 * sum(len(bias) for _, bias in garment_model.pose_modulator[:-1])
    sizes = len(garment_model.rig.dofs), len(garment_model.node_rest)
    sway = random_sway_network(np.random.default_rng(0), *sizes, modulation=modulation)
    save_garment_model(replace(garment_model, sway=sway), tmp_path / "swaying.safetensors")
    assert cli.main(["info", str(tmp_path / "swaying.safetensors")]) == 0
    assert "sway             by its sway network" in capsys.readouterr().out


def test_drape_writes_body_and_garment(model_path, garment_model, tmp_path, capsys):
    """The OBJ's second object is what the core gives for that frame, gravity included."""
    path = tmp_path / "out.obj"
    drape = ["drape", str(AVATAR), "--garment", str(model_path), "--motion", "walk", "--frame", "9"]
    assert cli.main([*drape, "--no-separate-limbs", "-o", str(path)]) == 0
    avatar = load_avatar(AVATAR, garment_model.rig)
    motion = load_motion("walk")
    assert motion.joint_names == garment_model.rig.joint_names
    expected = Draper(garment_model, avatar).drape(motion.positions[9], motion.gravity[9])
    written, first = read_mesh(path), len(avatar.vertices)
    assert written.look.parts == ("body", "garment")
    np.testing.assert_allclose(written.vertices[first:], expected[:, :3], atol=1e-6)
    np.testing.assert_array_equal(written.faces[written.look.part == 1], first + garment_model.garment.faces)


@pytest.mark.parametrize("fit", [None, 0.0])
def test_drape_and_bind_make_to_measure_unless_told_otherwise(fit, model_path, garment_model, tmp_path):
    """What both write is what the core gives by default, or at the fit that was asked for."""
    told = [str(AVATAR), "-g", str(model_path), *(() if fit is None else ("--fit", str(fit)))]
    assert cli.main(["drape", *told, "--no-separate-limbs", "-o", str(tmp_path / "out.obj")]) == 0
    assert cli.main(["bind", *told, "-o", str(tmp_path / "out.physkin")]) == 0
    motion, draper = load_motion("walk"), Draper(garment_model, load_avatar(AVATAR, garment_model.rig), fit=fit)
    assert draper.fit == (1.0 if fit is None else fit)
    expected = draper.drape(motion.positions[0], motion.gravity[0])[:, :3]
    np.testing.assert_allclose(read_mesh(tmp_path / "out.obj").vertices[-len(expected) :], expected, atol=1e-6)
    draper.save_bound(tmp_path / "expected.physkin")
    assert (tmp_path / "out.physkin").read_bytes() == (tmp_path / "expected.physkin").read_bytes()


def test_drape_separates_limbs_by_default(model_path, garment_model, tmp_path):
    """Body and garment are those of the separated positions."""
    path, arguments = tmp_path / "out.obj", ["drape", str(AVATAR), "-g", str(model_path), "--frame", "9"]
    assert cli.main([*arguments, "-o", str(path)]) == 0
    motion = load_motion("walk")
    draper = Draper(garment_model, load_avatar(AVATAR, garment_model.rig))
    positions, _ = LimbSeparator(garment_model.rig, draper.avatar).separate(motion.positions[9])
    cloth = draper.drape(positions, motion.gravity[9])
    assert np.abs(positions - motion.positions[9]).max() > 0.001
    drawn = Outfit([garment_model], load_avatar(AVATAR, garment_model.rig)).body_to_draw
    body = drawn.posed_vertices(garment_model.rig.bone_transforms(positions, heads=draper.avatar.bone_heads))
    np.testing.assert_allclose(read_mesh(path).vertices, np.concatenate([body, cloth[:, :3]]), atol=1e-5)


def test_drape_draws(model_path, tmp_path, monkeypatch):
    """A picture instead of a mesh, here a small one."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    monkeypatch.setattr(cli, "PICTURE_SIZE", (40, 50))
    path = tmp_path / "out.png"
    assert cli.main(["drape", str(AVATAR), "-g", str(model_path), "-o", str(path)]) == 0
    assert path.read_bytes().startswith(b"\x89PNG")


def test_warnings_about_an_avatar_are_printed_once(model_path, garment_model, tmp_path, capsys, monkeypatch, recwarn):
    """One line each, of the avatar and of how the garment sits, without Python's own about where it was issued."""
    warned = replace(load_avatar(AVATAR, garment_model.rig), warnings=("it limps",))
    monkeypatch.setattr("physkin_core.avatar.loading.load_gltf", lambda *_, **__: warned)
    assert cli.main(["bind", str(AVATAR), "-g", str(model_path), "-o", str(tmp_path / "out")]) == 0
    first, second = capsys.readouterr().err.splitlines()
    assert first == "warning: it limps" and "of the cloth is inside the body at rest" in second and not recwarn


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            ["drape", "{avatar}", "-g", "{model}", "--fit", "1.1", "-o", "{tmp}/out.obj"],
            "fit must be 0 (the template) to 1 (made to measure), got 1.1",
        ),
        (["info", "nosuch"], "no garment model 'nosuch'"),
        (["info", "{tmp}/nosuch.safetensors"], "nosuch.safetensors: no such file"),
        (["drape", "nosuch.glb", "-g", "{model}", "-o", "out.obj"], "no such file"),
        (["drape", "{avatar}", "-g", "{model}", "--motion", "nosuch", "-o", "out.obj"], "no bundled motion 'nosuch'"),
        (["drape", "{avatar}", "-g", "{model}", "--frame", "-1", "-o", "out.obj"], "has frames 0 to"),
        (["drape", "{avatar}", "-g", "{model}", "-o", "out.fbx"], "must end in .obj or .png"),
        (
            ["info", "{avatar}"],
            "avatar.glb is not a garment model, allowed are .safetensors files and circleskirt",
        ),
        (["drape", "{avatar}", "-g", "{model}", "-o", "{tmp}/none/out.obj"], "none/out.obj: there is no folder"),
        (["drape", "{avatar}", "-g", "{model}", "-o", "{tmp}/folder.obj"], "folder.obj: it is a folder"),
        (["check", "{avatar}", "-g", "{model}", "-o", "{tmp}/none/out.png"], "none/out.png: there is no folder"),
        (["check", "{avatar}", "-g", "{model}", "--json", "{tmp}/folder.obj"], "folder.obj: it is a folder"),
        (
            ["drape", "{mine}", "-g", "{model}", "-o", "{mine}"],
            "me.obj: it is the file that is read; give another name",
        ),
        (["bind", "{mine}", "-g", "{model}", "-o", "{mine}"], "me.obj: it is the file that is read; give another name"),
        (["export", "walk", "--avatar", "{tmp}/me.glb", "-o", "{tmp}/me.glb"], "me.glb: it is the file that is read"),
        (["bind-points", "tshirt", "{mine}", "-o", "{mine}"], "me.obj: it is the file that is read; give another name"),
    ],
)
def test_errors_are_one_line(arguments, reason, model_path, tmp_path, capsys):
    """Exit status 2 and a sentence on stderr."""
    (tmp_path / "folder.obj").mkdir()
    shutil.copy(AVATAR, tmp_path / "me.glb")
    mine = tmp_path / "me.obj"
    mine.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    filled = [word.format(model=model_path, avatar=AVATAR, mine=mine, tmp=tmp_path) for word in arguments]
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
@patch.dict(sys.modules)
def test_missing_extra_is_named(command, package, extra, capsys):
    """One line says what to install."""
    hidden, readers = ("physkin_ros", "physkin_training", package), "physkin_core.motion.bag_"
    for name in [name for name in sys.modules if name.split(".")[0] in hidden or name.startswith(readers)]:
        del sys.modules[name]
    sys.modules[package] = None  # makes `import` raise ModuleNotFoundError
    assert cli.main([command]) == 2
    assert f"physkin {command} needs: {install_command(extra)}" in capsys.readouterr().err


def test_errors_of_ours_are_told_in_one_line_unless_debugged(monkeypatch, capsys):
    """Status 1 and what to do; with --debug, wherever it stands, the error itself, mendable ones too."""
    monkeypatch.setattr("physkin_core.check.check.main", lambda argv: {}[f"no {argv}"])
    assert cli.main(["check", "a.glb"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: KeyError:") and "physkin --debug shows where" in said and said.count("\n") == 1
    with pytest.raises(KeyError, match=r"no \['a.glb'\]"):
        cli.main(["check", "a.glb", "--debug"])
    with pytest.raises(physkin_core.ModelFileError):
        cli.main(["--debug", "info", "nosuch"])


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_their_options(shell, capsys):
    """Of forwarded commands, too."""
    pytest.importorskip("shtab", reason="needs shtab: pip install 'physkin[completion]'")
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert [name for name in cli.TEXTS if name not in script] == []
    assert all(option in script for option in ("no-follow", "separate-limbs", "debug"))


def test_completion_does_without_what_is_not_installed(monkeypatch, capsys):
    """The command is known all the same."""
    pytest.importorskip("shtab", reason="needs shtab: pip install 'physkin[completion]'")
    monkeypatch.setitem(sys.modules, "physkin_ros.replay.command", None)
    assert cli.main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert "replay" in script and "--garment-topic" not in script
    assert "--no-follow" in script


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes(tmp_path, capsys):
    """Commands, options and what ships under a name, as bash itself finds them."""
    pytest.importorskip("shtab", reason="needs shtab: pip install 'physkin[completion]'")
    assert cli.main(["completion", "bash"]) == 0
    script = tmp_path / "physkin.bash"
    words = "COMP_WORDS=($*); COMP_CWORD=$(($# - 1)); _shtab_physkin physkin ${@: -1} ${@: -2:1}; echo ${COMPREPLY[*]}"
    script.write_text(f"{capsys.readouterr().out}\n{words}\n")
    for typed, expected in (
        ("physkin re", "render replay"),
        ("physkin render --fo", "--follow"),
        ("physkin render dan", "dance"),
        ("physkin drape -g sk", "skirt"),
    ):
        run = subprocess.run(["bash", script, *typed.split()], capture_output=True, text=True, cwd=tmp_path)
        assert run.stdout.split() == expected.split(), run.stderr


def test_arguments_reach_the_subcommand(monkeypatch):
    """They are handed on as they are, those of ROS too."""
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
    given = []
    monkeypatch.setattr("physkin_ros.node.node_process.main", given.extend)
    assert cli.main(["node", "--ros-args", "-p", "model:=dress"]) == 0
    assert given == ["--ros-args", "-p", "model:=dress"]


def test_usage_names_every_command(capsys):
    """Once, in a group; the error for a command that does not exist does so, too."""
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    output = capsys.readouterr().out
    listed = [line.split()[0] for line in output.splitlines() if re.match(r"  [a-z]", line)]
    assert sorted(listed) == sorted(cli.TEXTS)
    with pytest.raises(SystemExit, match="2"):
        cli.main(["dance"])


def test_drape_draws_a_strip(tmp_path, capsys, monkeypatch):
    """Frames of a motion from front and back in one picture; what cannot be drawn is told in one line."""
    image = pytest.importorskip("PIL.Image", reason="needs pillow: pip install 'physkin[view]'")
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    monkeypatch.setattr(filming, "FRAME_SIZE", (45, 80))
    out = tmp_path / "strip.png"
    drape = ["drape", str(AVATAR), "-o", str(out), "--strip"]
    assert cli.main([*drape, "2"]) == 0
    pixels = np.array(image.open(out))
    drawn = pixels.reshape(2, pixels.shape[0] // 2, 2, -1, 3)
    assert all(drawn[row, :, column].std() > 5 for row in (0, 1) for column in (0, 1))
    for count in ("1", "25"):
        assert cli.main([*drape, count]) == 2
        assert f"has 2 to 24 frames, got {count}" in capsys.readouterr().err
    assert cli.main(["drape", str(AVATAR), "-o", str(tmp_path / "strip.obj"), "--strip", "2"]) == 2
    assert "the name of a strip must end in .png" in capsys.readouterr().err


def test_drape_writes_an_outfit(tmp_path, capsys):
    """Several garments, one tucked in, are objects of one file; what cannot be worn is told in one line."""
    out = tmp_path / "worn.obj"
    worn = ["drape", str(AVATAR), "--garment", "tshirt", "--garment", "trousers", "-o", str(out)]
    assert cli.main([*worn, "--tucked", "tshirt"]) == 0
    assert read_mesh(out).look.parts == ("body", "tshirt", "trousers")
    assert cli.main([*worn, "--tucked", "dress"]) == 2
    assert "--tucked dress: none of the garments, which are tshirt, trousers" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--help"], ["info", "tshirt"]])
def test_a_reader_that_goes_ends_a_command_quietly(arguments):
    """As `head` does: no word of a broken pipe, neither where output is written nor where it is still held back."""
    reading, writing = os.pipe()
    os.close(reading)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    command = [sys.executable, "-m", "physkin_core.cli", *arguments]
    ended = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, env=environment)
    os.close(writing)
    assert (ended.returncode, ended.stderr) == (0, "")
