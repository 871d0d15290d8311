"""Scenes that begin and end at rest, and a simulation of one."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core.avatar.body_model import load_body_model
from physkin_core.cli import main
from physkin_core.motion.motion import MotionError
from physkin_core.rig.rig import Rig
from physkin_training.dynamics.reference import load_reference
from physkin_training.dynamics.scenes import ROOT_SCENES, SWING_ACCELERATION, load_scene, planted_legs

RIG = load_body_model().rig


@pytest.mark.parametrize("name", ["walk", "dance@0.5", *ROOT_SCENES])
def test_scenes_begin_at_rest_and_clips_end_there(name):
    scene = load_scene(name, RIG, seconds=4.0)
    assert scene.frame_count == 240
    change = np.abs(np.diff(np.concatenate([scene.positions, scene.root_position], axis=1), axis=0)).max(axis=1)
    assert change[0] < 2e-3
    if not name.startswith("swing"):
        assert change[-60:].max() == 0


def test_the_root_swings_as_hard_at_any_rate():
    for rate in (0.5, 1, 2):
        scene = load_scene(f"swing-{rate:g}", RIG, seconds=5.0).root_position[:, 1].astype(np.float64)
        acceleration = np.abs(np.diff(scene, n=2)[150:]).max() * 60**2
        assert acceleration == pytest.approx(SWING_ACCELERATION, rel=0.05)


@pytest.mark.parametrize(("name", "seconds"), [("walk", 1.0), ("kick@9", 5.0), ("nothing", 5.0)])
def test_scenes_that_cannot_be(name, seconds):
    with pytest.raises(MotionError):
        load_scene(name, RIG, seconds=seconds)


def test_planted_feet_stay_where_they_stand():
    """While hips go down and back, as on a chair, and the root leans forwards."""
    share = np.linspace(0, 1, 9)
    root, pitch = share[:, None] * [-0.40, 0.0, -0.38], np.radians(28) * share
    positions = np.tile(RIG.rest, (9, 1))
    for joint, angles in planted_legs(RIG, root, pitch).items():
        positions[:, RIG.joint_names.index(joint)] += angles
    bones = RIG.bone_transforms(positions)
    cosine, sine = np.cos(pitch), np.sin(pitch)
    for side in "LR":
        foot = bones[:, RIG.bone_index(f"foot.{side}")]
        x, y, z = (foot[:, :, :3] @ RIG.heads[RIG.bone_index(f"foot.{side}")] + foot[:, :, 3]).T
        ankle = np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=1) + root
        assert np.linalg.norm(ankle - ankle[0], axis=1).max() < 0.03  # thighs turn in their own planes, nearly upright


def test_a_rig_without_legs_cannot_sit():
    arm = Rig(("root",), np.array([-1]), np.zeros((1, 3)), np.array([[0, 0, 1.0]]), ())
    with pytest.raises(MotionError, match="upperleg01.L"):
        planted_legs(arm, np.zeros((1, 3)), np.zeros(1))


def test_the_command_refuses_what_makes_no_sense(tmp_path, capsys):
    for wrong, said in (
        (["--steps", "0"], "steps"),
        (["--seconds", "1"], "2.7 seconds"),
        (["--bodies", "0"], "bodies"),
    ):
        assert main(["simulate", "skirt", "--dynamic", *wrong, "-o", str(tmp_path)]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.slow
def test_a_simulated_skirt_hangs_still_while_nothing_moves(tmp_path):
    """The root of `stop` moves from 0.25 s on."""
    scene = ["--scenes", "stop", "--seconds", "2.7", "--bodies", "1", "--steps", "1"]
    assert main(["simulate", "skirt", "--dynamic", "--device", "cpu", *scene, "-o", str(tmp_path)]) == 0
    vertices = load_reference(tmp_path / "skirt_stop.npz").simulated(0)
    assert np.linalg.norm(vertices[5] - vertices[0], axis=1).max() < 2e-3
