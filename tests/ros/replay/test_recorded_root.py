"""Replays of bags that tell where the root is: cloth swings as a draper's does that is told the same."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from bag_messages import joint_state, recorded  # noqa: E402
from rosbags.typesys.stores import ros2_jazzy as ros  # noqa: E402

from physkin_core import Draper, cli, load_garment_model  # noqa: E402
from physkin_core.motion.bag_reader import IMU, JOINT_STATE, ODOMETRY, POSE, TRANSFORMS, BagError, BagReader  # noqa: E402
from physkin_ros.messages.conversions import read_cloud  # noqa: E402
from physkin_ros.replay.bags import BagWriter, write_motion  # noqa: E402
from physkin_ros.replay.recorded_root import RecordedRoot  # noqa: E402
from physkin_ros.replay.replay import GARMENT_TOPIC, replay  # noqa: E402

UNKNOWN = np.zeros(9)


@pytest.fixture(scope="module")
def lively(motion):
    """The clip with a root that starts, stops and turns."""
    t = np.arange(motion.frame_count)
    turn = 0.3 * np.sin(t)
    orientation = np.stack([0 * t, 0 * t, np.sin(turn / 2), np.cos(turn / 2)], axis=1)
    return replace(
        motion, root_position=np.stack([0.05 * np.sin(t), 0.02 * t, 0 * t + 1], 1), root_orientation=orientation
    )


@pytest.fixture(scope="module")
def world_bag(lively, tmp_path_factory):
    """That clip with odometry, TF, and the root as poses, too."""
    path = tmp_path_factory.mktemp("bags") / "lively.mcap"
    with BagWriter(tmp := path.with_name("plain.mcap")) as writer:
        write_motion(writer, lively, frame_id="base_link", world_frame="world")
    with BagReader(tmp, root=["odometry", "transforms"]) as bag, BagWriter(path) as writer:
        for message in bag:
            kind = {"joint_state": JOINT_STATE, "odometry": ODOMETRY, "transforms": TRANSFORMS}.get(message.kind)
            if kind is None:
                continue
            writer.write_bytes(message.topic, kind, message.data, message.time_ns)
        for _, time_ns, told in (entry for entry in recorded(tmp) if entry[0] == "/odom"):
            stamped = ros.geometry_msgs__msg__PoseStamped(told.header, told.pose.pose)
            writer.write("/root_pose", POSE, stamped, time_ns - 1)
    return path


@pytest.fixture(scope="module")
def swaying(swaying_model_path):
    """With a sway network."""
    return load_garment_model(swaying_model_path)


def clouds_of(draper, path, root, tmp_path, **of_root):
    """The clouds of a replay, and what came of it."""
    output = tmp_path / f"{root.orientation}{root.sway}.mcap"
    with BagReader(path, orientation=root.orientation, **of_root) as bag, BagWriter(output) as writer:
        found = replay(draper, bag, writer, root=root)
    return np.stack([read_cloud(cloud) for topic, _, cloud in recorded(output) if topic == GARMENT_TOPIC]), found


@pytest.mark.parametrize(
    ("orientation", "sway", "learnt"),
    [("odometry", 1.0, True), ("odometry", 1.0, False), ("tf", 0.4, True), ("pose", 1.0, True)],
)
def test_cloth_swings_as_that_of_a_draper(orientation, sway, learnt, swaying, avatar, lively, world_bag, tmp_path):
    """That is told the same times and places, bit for bit; with a network and without, which swings nothing."""
    model = swaying if learnt else replace(swaying, sway=None)
    draper, told = Draper(model, avatar), Draper(model, avatar)
    told.sway = sway
    clouds, found = clouds_of(draper, world_bag, RecordedRoot(orientation, sway=sway), tmp_path)
    assert found.counts["draped"] == found.counts["gravity_messages"] == lively.frame_count
    assert found.counts["gravity_rejected"] == found.counts["root_unknown"] == 0
    swung, stamps = 0.0, [told.header.stamp for topic, _, told in recorded(world_bag) if topic == "/joint_states"]
    for k, (q, stamp) in enumerate(zip(lively.positions_for(model.rig), stamps, strict=True)):
        place = (*lively.root_position[k].astype(np.float64), *lively.root_orientation[k].astype(np.float64))
        expected = told.drape(q, time=stamp.sec + 1e-9 * stamp.nanosec, root=place)
        np.testing.assert_array_equal(clouds[k], expected)
        swung = max(swung, np.abs(clouds[k] - draper.drape(q, lively.gravity[k]))[:, :3].max())
    assert (swung > 0.005) == learnt


def test_gravity_alone_is_the_default(swaying, avatar, world_bag, tmp_path):
    """A bag that knows more is draped as without it; another orientation is another recording to be compared."""
    draper = Draper(swaying, avatar)
    still, found = clouds_of(draper, world_bag, RecordedRoot(), tmp_path)
    moved, others = clouds_of(draper, world_bag, RecordedRoot("odometry"), tmp_path)
    assert found.counts["gravity_messages"] == 0 and found.bag_sha256 != others.bag_sha256
    assert np.abs(still - moved)[..., :3].max() > 0.005


def test_an_imu_leans_cloth(swaying, avatar, tmp_path):
    """Its acceleration counts as the node takes it; what it cannot measure is refused."""
    model, path = replace(swaying, sway=None), tmp_path / "imu.mcap"
    rest, turn = model.rig.rest, ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)
    none = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
    with BagWriter(path) as writer:
        for k in range(40):
            header = ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(1, 20_000_000 * k), "")
            force = ros.geometry_msgs__msg__Vector3(np.nan if k == 30 else 9.81, 0.0, 9.81)
            message = ros.sensor_msgs__msg__Imu(header, turn, UNKNOWN, none, UNKNOWN, force, UNKNOWN)
            writer.write("/imu", IMU, message, 10**9 + 20_000_000 * k)
            state = replace(joint_state(model.rig.joint_names, rest), header=header)
            writer.write("/joint_states", JOINT_STATE, state, 10**9 + 20_000_000 * k)
    draper = Draper(model, avatar)
    root = RecordedRoot("imu")
    _, found = clouds_of(draper, path, root, tmp_path)
    assert found.counts["gravity_rejected"] == 1 and found.counts["draped"] == 40
    assert root.rows[0, :3] == pytest.approx([-1, 0, -1], abs=1e-3)
    assert found.down[-1] == pytest.approx([0, 0, -1])


def test_bad_messages_change_nothing(swaying, avatar, lively, world_bag, tmp_path):
    """What is not finite, goes back or is no message: counted, with the reason."""
    bad, draper = tmp_path / "bad.mcap", Draper(swaying, avatar)
    with BagReader(world_bag, root=["odometry"]) as bag, BagWriter(bad) as writer:
        for k, message in enumerate(bag):
            kind = {"joint_state": JOINT_STATE, "odometry": ODOMETRY}[message.kind]
            writer.write_bytes(message.topic, kind, message.data, message.time_ns)
            if k == 4:
                back, now = ros_odometry(world_bag, 0), ros_odometry(world_bag, 2)
                nowhere = replace(now.pose.pose, position=ros.geometry_msgs__msg__Point(np.nan, 0.0, 0.0))
                writer.write("/odom", ODOMETRY, back, message.time_ns + 1)
                writer.write("/odom", ODOMETRY, replace(now, pose=replace(now.pose, pose=nowhere)), message.time_ns + 2)
                writer.write_bytes("/odom", ODOMETRY, b"\0\1\0\0\7", message.time_ns + 3)
    clouds, found = clouds_of(draper, bad, RecordedRoot("odometry"), tmp_path)
    (tmp_path / "good").mkdir()
    expected, _ = clouds_of(draper, world_bag, RecordedRoot("odometry"), tmp_path / "good")
    np.testing.assert_array_equal(clouds, expected)
    assert found.counts["gravity_rejected"] == 3 and found.counts["gravity_messages"] == lively.frame_count + 3
    for told in ("bytes that are no odometry", "it must be finite [m]", "s back"):
        assert any(told in reason for reason in found.reasons), told


def ros_odometry(path, index):
    """An odometry message of a bag."""
    return [message for topic, _, message in recorded(path) if topic == "/odom"][index]


def test_tf_that_does_not_lead_to_the_world_is_told(swaying, avatar, lively, world_bag, tmp_path):
    """Clouds are then those of a root at rest; how many is counted."""
    draper = Draper(swaying, avatar)
    lost, found = clouds_of(draper, world_bag, RecordedRoot("tf", world_frame="hall"), tmp_path)
    assert found.counts["root_unknown"] == found.counts["draped"] == lively.frame_count
    still, _ = clouds_of(draper, world_bag, RecordedRoot(), tmp_path)
    np.testing.assert_array_equal(lost, still)


def test_the_command_line_takes_what_the_node_takes(quick, swaying_model_path, world_bag, tmp_path, capsys):
    """And says in figures what was taken."""
    figures = tmp_path / "out.json"
    told = ["replay", str(world_bag), "-g", str(swaying_model_path), "--json", str(figures)]
    asked = ["--orientation", "pose", "--sway", "0.5", "--report", str(tmp_path / "page.html")]
    assert cli.main([*told, *asked]) == 0
    run, bag = (json.loads(figures.read_text())[part] for part in ("run", "bag"))
    assert (run["orientation"], run["sway"], bag["gravity_topic"]) == ("pose", 0.5, "/root_pose")
    assert "poses of the root / rejected" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (["--orientation", "imu"], "has no topic of sensor_msgs/msg/Imu; its topics"),
        (["--orientation-topic", "/odom"], "topic /odom is nav_msgs/msg/Odometry"),
        (["--orientation", "pose", "--orientation-topic", "/odom"], "topic /odom is nav_msgs/msg/Odometry"),
        (["--sway", "1.5"], "sway must be a number from 0 to 1, got 1.5"),
    ],
)
def test_what_does_not_fit_is_refused(asked, told, quick, swaying_model_path, world_bag, capsys):
    """With what would."""
    assert cli.main(["replay", str(world_bag), "-g", str(swaying_model_path), *asked]) != 0
    assert told in capsys.readouterr().err


def test_readers_refuse_what_is_not_there(bag, world_bag):
    """A bag without TF, a topic for TF, and an orientation that nobody knows."""
    for path, asked, told in (
        (bag, {"orientation": "tf"}, "no transforms on /tf or /tf_static; its topics: /gravity"),
        (world_bag, {"orientation": "tf", "orientation_topic": "/x"}, "TF is always taken from /tf and /tf_static"),
        (world_bag, {"orientation": "joints"}, "unknown orientation 'joints'; allowed: gravity, pose"),
    ):
        with pytest.raises(BagError, match=told):
            BagReader(path, **asked)
