"""Bags as files: what is written can be played, what is asked for is found; motion clips as bags."""

from __future__ import annotations

import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from bag_messages import gravity, joint_state, recorded  # noqa: E402
from rosbags.rosbag2 import Reader  # noqa: E402

from physkin_core import cli, load_motion  # noqa: E402
from physkin_core.motion.bag_reader import GRAVITY, JOINT_STATE, TYPES, BagError, BagReader  # noqa: E402
from physkin_ros.replay.bags import BagWriter  # noqa: E402


def test_output_is_playable(tmp_path):
    """What `ros2 bag play` of Jazzy reads: metadata version 9, type, hash and definition.

    A cloud that is not finite is not dense.
    """
    points = np.full((4, 6), np.inf, dtype=np.float32)
    with BagWriter(tmp_path / "out") as writer:
        writer.write_cloud("/garment", points, SimpleNamespace(sec=1, nanosec=2), "torso", 5)
    ((_, _, cloud),) = recorded(tmp_path / "out")
    assert not cloud.is_dense and cloud.header.frame_id == "torso" and cloud.header.stamp.nanosec == 2
    metadata = (tmp_path / "out" / "metadata.yaml").read_text()
    assert re.search(r"^  version: 9$", metadata, re.M) and "storage_identifier: mcap" in metadata
    assert re.search(r"^  message_count: 1$", metadata, re.M)
    with Reader(tmp_path / "out") as reader:
        (connection,) = reader.connections
        assert connection.msgtype == "sensor_msgs/msg/PointCloud2" and "uint32 point_step" in connection.msgdef.data
        assert connection.digest == TYPES.hash_rihs01(connection.msgtype)


def test_the_only_joint_states_are_found(tmp_path):
    """Another name is no obstacle; two of them are."""
    state = joint_state(["hip"], [0.0])
    with BagWriter(tmp_path / "1.mcap") as one, BagWriter(tmp_path / "2.mcap") as two:
        for writer, topic in ((one, "/body0/joint_states"), (two, "/body0/joint_states"), (two, "/body1/joint_states")):
            writer.write(topic, JOINT_STATE, state, 1)
    with BagReader(tmp_path / "1.mcap") as bag:
        assert (bag.topic, bag.orientation_topic, bag.joint_state_count) == ("/body0/joint_states", None, 1)
    with pytest.raises(BagError, match="which topic.*/body0/joint_states, /body1/joint_states"):
        BagReader(tmp_path / "2.mcap")


def test_files_that_are_no_bags_of_joint_states(tmp_path):
    """Each is told with what to do about it."""
    whole, broken, old, mesh = (tmp_path / name for name in ("whole.mcap", "broken.mcap", "old.bag", "me.obj"))
    with BagWriter(whole) as writer:
        writer.write("/gravity", GRAVITY, gravity(0, 0, -1), 1)
    broken.write_bytes(whole.read_bytes()[:-20])
    for file in (old, mesh):
        file.write_bytes(b"#ROSBAG V2.0\n")
    for file, told in (
        (whole, "has no topic of sensor_msgs/msg/JointState; its topics: /gravity (geometry_msgs/msg/Vector3Stamped)"),
        (broken, "The recording was broken off; mcap recover"),
        (old, "Bags of ROS 1 are converted by rosbags-convert"),
        (mesh, "Allowed: .mcap, .db3, or a folder"),
    ):
        with pytest.raises(BagError, match=re.escape(told)):
            BagReader(file)


def test_failed_block_leaves_no_bag(tmp_path):
    """Half a bag would be taken for a whole one."""
    with pytest.raises(RuntimeError), BagWriter(tmp_path / "out") as writer:
        writer.write("/joint_states", JOINT_STATE, joint_state(["hip"], [0.0]), 1)
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_convert_writes_what_the_clip_holds(tmp_path, capsys):
    """Names, positions and gravity of the shipped clip, gravity first, at its rate and at another."""
    path, motion = tmp_path / "walk.mcap", load_motion("walk")
    assert cli.main(["convert", "walk", str(path)]) == 0
    assert f"{motion.frame_count} joint states at 60 Hz" in capsys.readouterr().out
    entries = recorded(path)
    assert [topic for topic, *_ in entries] == ["/gravity", "/odom", "/tf", "/joint_states"] * motion.frame_count
    states = [message for topic, _, message in entries if topic == "/joint_states"]
    assert tuple(states[0].name) == motion.joint_names
    np.testing.assert_array_equal([state.position for state in states], motion.positions)
    down = [message.vector for topic, _, message in entries if topic == "/gravity"]
    np.testing.assert_allclose([[v.x, v.y, v.z] for v in down], motion.gravity)
    up = Rotation.from_quat(motion.root_orientation).inv().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(motion.gravity, -up, atol=1e-6)
    times = np.array([time_ns for topic, time_ns, _ in entries if topic == "/joint_states"])
    np.testing.assert_allclose(np.diff(times), 1e9 / 60, atol=1)
    assert [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in states] == times.tolist()
    slow = tmp_path / "slow"
    assert cli.main(["convert", "walk", str(slow), "--rate", "30", "--seconds", "2"]) == 0
    assert sum(topic == "/joint_states" for topic, *_ in recorded(slow)) == 60


def test_convert_writes_where_the_root_is(tmp_path):
    """TF and odometry alike; the twist, seen from the root, leads from one frame to the next. Or neither."""
    motion, path = load_motion("cartwheel"), tmp_path / "turn.mcap"
    assert cli.main(["convert", "cartwheel", str(path), "--world-frame", "map", "--frame-id", "torso"]) == 0
    entries = recorded(path)
    transforms = [message.transforms for topic, _, message in entries if topic == "/tf"]
    found = [message for topic, _, message in entries if topic == "/odom"]
    assert len(found) == len(transforms) == motion.frame_count and all(len(each) == 1 for each in transforms)
    assert {(odom.header.frame_id, odom.child_frame_id) for odom in found} == {("map", "torso")}
    assert {(tf.header.frame_id, tf.child_frame_id) for (tf,) in transforms} == {("map", "torso")}

    def numbers(*parts):
        return np.array([[getattr(part, name) for name in "xyzw"[: 4 if hasattr(part, "w") else 3]] for part in parts])

    places, turns = ([getattr(odom.pose.pose, name) for odom in found] for name in ("position", "orientation"))
    np.testing.assert_allclose(numbers(*places), motion.root_position, atol=1e-6)
    np.testing.assert_allclose(numbers(*turns), motion.root_orientation, atol=1e-6)
    np.testing.assert_array_equal(numbers(*(tf.transform.translation for (tf,) in transforms)), numbers(*places))
    np.testing.assert_array_equal(numbers(*(tf.transform.rotation for (tf,) in transforms)), numbers(*turns))
    turns, step = Rotation.from_quat(numbers(*turns)), 1 / motion.rate_hz
    moved = turns[1:-1].apply(numbers(*(odom.twist.twist.linear for odom in found[1:-1]))) * 2 * step
    np.testing.assert_allclose(moved, motion.root_position[2:] - motion.root_position[:-2], atol=1e-5)
    spun = turns[:-2] * Rotation.from_rotvec(numbers(*(odom.twist.twist.angular for odom in found[1:-1])) * 2 * step)
    assert np.degrees((spun.inv() * turns[2:]).magnitude()).max() < 2
    none = tmp_path / "none.mcap"
    assert cli.main(["convert", "cartwheel", str(none), "--world-frame", ""]) == 0
    assert {topic for topic, *_ in recorded(none)} == {"/gravity", "/joint_states"}


@pytest.mark.parametrize("output", ["{tmp}/there", "/proc/out.mcap", "{tmp}/no/out"])
def test_convert_refuses_an_output_before_it_reads_the_motion(output, tmp_path, monkeypatch, capsys):
    """Reading motion capture may take a minute."""
    monkeypatch.setattr("physkin_ros.replay.convert.load_clip", lambda *_, **__: pytest.fail("the motion was read"))
    (tmp_path / "there").mkdir()
    output = output.format(tmp=tmp_path)
    assert cli.main(["convert", "walk.bvh", output]) == 2
    assert output in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_needs_no_ros():
    """Every module of physkin_ros.replay can be imported where there is no rclpy and no message package."""
    code = """
import sys
sys.modules |= dict.fromkeys(("rclpy", "sensor_msgs", "geometry_msgs", "rosidl_runtime_py", "matplotlib", "mitsuba"))
import importlib, pkgutil, physkin_ros.replay
for module in pkgutil.iter_modules(physkin_ros.replay.__path__, "physkin_ros.replay."):
    importlib.import_module(module.name)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
