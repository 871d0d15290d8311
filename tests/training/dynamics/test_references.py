"""Scenes that begin and end at rest, and references that are what was recorded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.motion import MotionError
from physkin_core.rig.rig import Rig
from physkin_training.dynamics.command import main
from physkin_training.dynamics.reference import Reference, load_reference, save_reference, spread, swinging_vertices
from physkin_training.dynamics.scenes import ACTED_SCENES, RISE, ROOT_SCENES, SWING_ACCELERATION, load_scene
from physkin_training.dynamics.swing_figures import settling, swing

RIG = load_body_model().rig


@pytest.mark.parametrize("name", ["walk", "dance@0.5", *ROOT_SCENES, *ACTED_SCENES])
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


@pytest.mark.parametrize(("name", "seconds"), [("walk", 1.0), ("kick@9", 5.0), ("nothing", 5.0), ("stairs", 2.7)])
def test_scenes_that_cannot_be(name, seconds):
    with pytest.raises(MotionError):
        load_scene(name, RIG, seconds=seconds)


@pytest.mark.parametrize(("name", "bend"), [("stairs", 70), ("sit", 90)])
def test_feet_of_acted_scenes_stay_where_they_stand_and_thighs_are_raised(name, bend):
    scene = load_scene(name, RIG, seconds=4.2)
    assert (scene.positions >= RIG.lower).all() and (scene.positions <= RIG.upper).all()
    turn = Rotation.from_quat(scene.root_orientation).as_matrix()
    bones = RIG.bone_transforms(scene.positions)

    def place(bone: str, at: np.ndarray) -> np.ndarray:
        bone = bones[:, RIG.bone_index(bone)]
        return np.einsum("tij,tj->ti", turn, bone[:, :, :3] @ at + bone[:, :, 3]) + scene.root_position

    for side in "LR":
        thigh, shin, foot = (RIG.bone_index(f"{bone}.{side}") for bone in ("upperleg01", "lowerleg01", "foot"))
        hip, knee, ankle = (place(RIG.bone_names[bone], RIG.heads[bone]) for bone in (thigh, shin, foot))
        assert ankle[:, 2].min() > ankle[0, 2] - 0.005
        height = ankle[:, 2] - ankle[0, 2]
        stands = np.flatnonzero(np.isin(np.round(height, 3), np.round(RISE * np.arange(4), 3)))
        for run in np.split(stands, np.flatnonzero(np.diff(stands) > 1) + 1):
            if len(run) > 12:  # not one that passes the height of a stair
                assert np.linalg.norm(ankle[run] - ankle[run[len(run) // 2]], axis=1).max() < 0.03
        down = (knee - hip)[:, 2] / np.linalg.norm(knee - hip, axis=1)
        assert np.degrees(np.arccos(-down)).max() == pytest.approx(bend, abs=10)
        assert {"stairs": 3 * RISE, "sit": 0}[name] == pytest.approx(height[-1], abs=0.005)


def test_a_rig_without_legs_cannot_climb():
    arm = Rig(("root",), np.array([-1]), np.zeros((1, 3)), np.array([[0, 0, 1.0]]), ())
    with pytest.raises(MotionError, match="upperleg01.L"):
        load_scene("stairs", arm, seconds=5.0)


def test_a_reference_is_read_as_it_was_written(tmp_path):
    generator = np.random.default_rng(0)
    motion = load_scene("turn", RIG, seconds=3.0)
    points = np.cumsum(generator.normal(scale=1e-3, size=(2, 180, 5, 3)), axis=1) + [0.2, -0.3, 0.9]
    whole = generator.uniform(-1, 1, size=(2, 7, 3))
    written = Reference(
        *("skirt", motion, generator.normal(size=(2, 4)), np.arange(5), points, np.array([180, 90])),
        *({"stretch": generator.random((2, 180))}, 1, np.array([0, 60]), whole, {"step_s": 0.004}),
    )
    save_reference(written, tmp_path / "skirt_turn.npz")
    read = load_reference(tmp_path / "skirt_turn.npz")
    assert np.abs(read.points - points).max() <= 0.51e-4
    assert np.abs(read.whole - whole).max() <= 0.51e-4
    assert np.abs(read.motion.positions - motion.positions).max() <= 0.51e-4
    assert (read.motion.name, read.garment, read.described["step_s"]) == ("turn", "skirt", 0.004)
    assert (read.frames == [180, 90]).all() and (read.whole_frames == [0, 60]).all()
    (tmp_path / "other_turn.npz").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="no reference"):
        load_reference(tmp_path / "other_turn.npz")


def test_points_are_spread_over_what_swings():
    model = load_garment_model("dress")
    below = swinging_vertices(model.garment, RIG)
    assert model.garment.vertices[below, 2].max() < 0
    chosen = spread(model.garment.vertices[below], 40)
    assert len(np.unique(chosen)) == 40


def test_amplitude_phase_and_settling_are_those_of_a_known_swing():
    scene = load_scene("swing-1", RIG, seconds=5.0)
    times, points = np.arange(300) / 60, np.zeros((300, 9, 3))
    points[:, :, 2] = np.arange(9)
    points[:, :, 1] = 0.03 * np.sin(2 * np.pi * (times - 0.25) - np.radians(40))[:, None]
    found = swing(points, scene, 1.0)
    assert found["amplitude_mm"] == pytest.approx(30, rel=0.02)
    assert found["phase_degrees"] == pytest.approx(-40, abs=2)
    stop = load_scene("stop", RIG, seconds=5.0)
    after = np.maximum(times - 2.25, 0)
    points[:, :, 1] = 0
    points[:, :, 0] = (0.1 * np.exp(-4 * after) * (times >= 2.25))[:, None]
    found = settling(points, points, stop)
    assert found["overshoot_mm"] == pytest.approx(100, rel=0.1)
    assert found["settling_s"] == pytest.approx(np.log(10) / 4, abs=0.05)


def test_the_command_refuses_what_makes_no_sense(tmp_path, capsys):
    for wrong, said in (
        (["--steps", "0"], "steps"),
        (["--tolerance", "0"], "tolerance"),
        (["--air-drag", "-1"], "air_drag"),
    ):
        assert main(["skirt", "--dynamic", *wrong, "-o", str(tmp_path)]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.slow
def test_a_simulated_skirt_hangs_still_while_nothing_moves(tmp_path):
    scene = ["--scenes", "stop", "--seconds", "2.7", "--bodies", "1", "--steps", "2", "--minutes", "0.5"]
    assert main(["skirt", "--dynamic", "--device", "cpu", *scene, "-o", str(tmp_path)]) == 0
    reference = load_reference(tmp_path / "skirt_stop.npz")
    assert reference.points.shape[1] > 5
    assert np.abs(reference.points[0, 5] - reference.points[0, 0]).max() < 1e-3
