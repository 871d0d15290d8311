"""Landmarks to joint positions in JavaScript: as physkin_core.LandmarkReader reads the same frames."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from posed_landmarks import CAMERA, landmarks_of
from scipy.spatial.transform import Rotation

from import_graph import ROOT
from physkin_core import LandmarkReader, load_body_model, load_motion
from physkin_core.motion.landmarks import LANDMARK_SETS, USED
from physkin_core.rig.joint_names import plain_name

NODE = shutil.which("node")
SCRIPT = Path(__file__).with_name("run_landmarks.mjs")
RATE_HZ = 15.0
ROUNDING = np.radians(0.01)
"""Tables are written with seven digits, and both compute in double precision: far below a fraction of a degree."""

pytestmark = pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs")


@pytest.fixture(scope="module")
def rig():
    return load_body_model().rig


def camera_frames(rig, name, yaw=0.0):
    """Landmarks (T, 33, 4) of a clip as MediaPipe gives them, from the middle of the hips; we have 21 of them."""
    motion = load_motion(name).resampled(RATE_HZ)
    root = motion.root.astype(np.float64)
    root[:, 3:] = (Rotation.from_euler("z", yaw, degrees=True) * Rotation.from_quat(root[:, 3:])).as_quat()
    ours = landmarks_of(rig, motion.positions_for(rig), root)
    hips = [USED.index(f"hip.{side}") for side in "LR"]
    ours = (ours - ours[:, hips].mean(axis=1, keepdims=True)) @ CAMERA.T
    frames = np.zeros((len(ours), 33, 4))
    for column, landmark in enumerate(LANDMARK_SETS["mediapipe"]["names"].split()):
        part, side = plain_name(landmark).split(".")
        if (known := f"{part.replace('footindex', 'toe')}.{side}") in USED:
            frames[:, column] = np.append(ours[:, USED.index(known)], np.ones((len(ours), 1)), axis=1)
    return frames


def both(rig, times, frames, tmp_path):
    """What Python and JavaScript read: positions, roots, and what is lost. None: nobody is seen."""
    reader, ours, said = LandmarkReader("mediapipe"), [], []
    for time, frame in zip(times, frames):
        frame = np.full((33, 4), np.nan) if frame is None else frame
        ours.append(np.concatenate(reader.read(frame[:, :3], frame[:, 3], time_s=time)))
        said.append((reader.status, list(reader.lost)))
    limits = zip(rig.joint_names, rig.lower.tolist(), rig.rest.tolist(), rig.upper.tolist())
    case = {
        "table": json.loads(reader.to_json()),
        "joints": [{"name": name, "lower": lower, "rest": rest, "upper": upper} for name, lower, rest, upper in limits],
        "frames": [[time, None if frame is None else frame.tolist()] for time, frame in zip(times, frames)],
    }
    (tmp_path / "case.json").write_text(json.dumps(case))
    command = [NODE, SCRIPT, ROOT / "native" / "web", tmp_path / "case.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    theirs = json.loads(done.stdout)
    ours = np.array(ours)
    return (ours[:, :-7], ours[:, -7:], said), (
        np.array([each["positions"] for each in theirs]),
        (np.array([each["height"] for each in theirs]), np.array([each["root"] for each in theirs]).reshape(-1, 3, 3)),
        [(each["status"], each["lost"]) for each in theirs],
    )


def assert_same(ours, theirs):
    """Within rounding, and the same is said."""
    assert np.abs(ours[0] - theirs[0]).max() < ROUNDING
    heights, turns = theirs[1]
    assert np.abs(ours[1][:, :3] - heights[:, None] * [0, 0, 1]).max() < 1e-4
    assert np.abs(Rotation.from_quat(ours[1][:, 3:]).as_matrix() - turns).max() < ROUNDING
    assert ours[2] == theirs[2]


@pytest.mark.parametrize(("name", "yaw"), [("walk", 0), ("dance", 90), ("kick", 180), ("cartwheel", -135)])
def test_clips_are_read_alike(rig, tmp_path, name, yaw):
    """With noise, whichever way the person faces."""
    frames = camera_frames(rig, name, yaw)
    noise = np.random.default_rng(1).normal(0, 0.01, frames.shape) * (frames != 0)
    frames[..., :3] += noise[..., :3]
    assert_same(*both(rig, np.arange(len(frames)) / RATE_HZ, frames, tmp_path))


def test_gaps_are_read_alike(rig, tmp_path):
    """Landmarks that flicker, half a body, a person who leaves for four seconds."""
    frames = np.tile(camera_frames(rig, "dance"), (3, 1, 1))[:150]
    times = np.arange(len(frames)) / RATE_HZ
    frames[:, :, 3] *= np.random.default_rng(2).random(frames.shape[:2]) > 0.2
    frames[30:60, 23:, 3] = 0.0  # from the hips down
    frames[60:70, 12, 3] = 0.0  # a shoulder
    shown = [None if 80 <= at < 140 else frame for at, frame in enumerate(frames)]
    assert_same(*both(rig, times, shown, tmp_path))


def test_who_is_lost_is_held_then_eased_to_rest(rig, tmp_path):
    """A person who leaves: the last pose for a second, near rest after six more; no joint ever jumps."""
    frames = camera_frames(rig, "walk")[:15]
    shown = [*frames, *[None] * 120]
    _, (positions, _, said) = both(rig, np.arange(len(shown)) / RATE_HZ, shown, tmp_path)
    last = positions[14]
    assert np.abs(positions[15:29] - last).max() < 1e-9
    assert np.abs(positions[-1] - rig.rest).max() < 0.05 * np.abs(last - rig.rest).max()
    assert np.abs(np.diff(positions[14:], axis=0)).max() < 0.1 * np.abs(last - rig.rest).max()
    assert said[14] == ("seen", []) and said[15] == ("lost", ["trunk"])
