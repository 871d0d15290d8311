"""The example that turns a camera or a film into joint states, with a tracker that sees what the test says."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from posed_landmarks import CAMERA, landmarks_of

from physkin_core import LandmarkReader, load_body_model, load_motion
from physkin_core.motion.landmarks import LANDMARK_SETS, USED
from physkin_core.rig.joint_names import plain_name

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
pytest.importorskip("tf2_msgs", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")

EXAMPLE = Path(__file__).parents[3] / "physkin_ros" / "examples" / "camera_joint_states.py"
RATE_HZ, LOST = 20.0, 5
"""Of the film; frames at its end in which nobody is seen."""
CV2 = """
import numpy as np
CAP_PROP_FPS, COLOR_BGR2RGB = 5, 4
class VideoCapture:
    def __init__(self, source): self.source, self.frame = source, -1
    def isOpened(self): return self.source == "film.mp4"
    def get(self, what): return 20.0
    def read(self):
        self.frame += 1
        return True, np.full((2, 2, 3), self.frame) if self.frame < len(__import__("mediapipe").POINTS) else None
def cvtColor(picture, code): return picture
"""
MEDIAPIPE = """
import json, pathlib
from types import SimpleNamespace as Space
POINTS = json.loads((pathlib.Path(__file__).with_name("points.json")).read_text())
class Pose:
    def __init__(self, model_complexity, smooth_landmarks): pass
    def process(self, picture):
        points = POINTS[picture[0, 0, 0]]
        marks = points and Space(landmark=[Space(x=x, y=y, z=z, visibility=v) for x, y, z, v in points])
        return Space(pose_world_landmarks=marks)
solutions = Space(pose=Space(Pose=Pose, PoseLandmark=range(33)))
"""


@pytest.fixture
def points(tmp_path, monkeypatch):
    """Landmarks of a walk, then nobody, beside modules that give them."""
    rig = load_body_model().rig
    walk = load_motion("walk").resampled(RATE_HZ)
    ours = landmarks_of(rig, walk.positions_for(rig), walk.root.astype(np.float64)) @ CAMERA.T
    ours = np.tile(ours, (4, 1, 1))  # long enough to be found by a listener
    seen = np.zeros((len(ours), 33, 4))
    for column, name in enumerate(LANDMARK_SETS["mediapipe"]["names"].split()):
        part, side = plain_name(name).split(".")
        if (known := f"{part.replace('footindex', 'toe')}.{side}") in USED:
            seen[:, column, :3], seen[:, column, 3] = ours[:, USED.index(known)], 1.0
    for name, text in (("cv2.py", CV2), ("mediapipe.py", MEDIAPIPE)):
        (tmp_path / name).write_text(textwrap.dedent(text))
    (tmp_path / "points.json").write_text(json.dumps([*seen.tolist(), *[None] * LOST]))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return seen


def test_a_film_becomes_a_ros4hri_body(domain, points):
    """Joint positions by the rig's names on the body's topic, as LandmarkReader reads them; the root in TF; and what is
    seen, each time that it changes."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import JointState
    from tf2_msgs.msg import TFMessage

    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("listener", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    states, transforms = [], []
    node.create_subscription(JointState, "/humans/bodies/ann/joint_states", states.append, 100)
    node.create_subscription(TFMessage, "/tf", transforms.append, 100)
    process = subprocess.Popen([sys.executable, EXAMPLE, "film.mp4", "ann"], stdout=subprocess.PIPE, text=True)
    while process.poll() is None:
        executor.spin_once(timeout_sec=0.05)
    executor.spin_once(timeout_sec=0.2)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)
    said = process.communicate()[0].splitlines()
    assert process.returncode == 0
    assert said == ["seen", "lost, no trunk"]

    reader = LandmarkReader("mediapipe")
    frames = [*points, *[np.full((33, 4), np.nan)] * LOST]
    read = [reader.read(each[:, :3], each[:, 3], time_s=at / RATE_HZ) for at, each in enumerate(frames)]
    assert len(states) > len(frames) / 2  # the first may come before the listener is known
    assert tuple(states[0].name) == load_body_model().rig.joint_names
    expected = [positions for positions, _ in read[-len(states) :]]
    assert np.abs(np.array([state.position for state in states]) - expected).max() < 1e-9
    (place,) = transforms[-1].transforms
    assert (place.header.frame_id, place.child_frame_id) == ("world", "body_ann")
    assert place.transform.translation.z == pytest.approx(read[-1][1][2])


def test_a_film_that_is_missing_is_named(domain, points):
    run = subprocess.run([sys.executable, EXAMPLE, "none.mp4"], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert run.stderr == "error: none.mp4 cannot be opened\n"
