"""`physkin replay --live`: a bag's messages reach their topics, in order, in time."""

from __future__ import annotations

import sys
import time

import numpy as np
import pytest

from physkin_core import cli, load_motion

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from geometry_msgs.msg import Vector3Stamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from physkin_ros.replay.bags import BagWriter, write_motion  # noqa: E402


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Two seconds of a motion, on topics of its own."""
    path = tmp_path_factory.mktemp("bags") / "walk.mcap"
    motion = load_motion("walk").resampled(30.0).looped(2.0)
    with BagWriter(path) as writer:
        names = {"topic": "/arm/joints", "frame_id": "torso", "world_frame": "hall"}
        write_motion(writer, motion, **names)
    return path, motion


@pytest.mark.slow
def test_every_message_arrives(peer, start, bag):
    """Joint states, gravity and where the root is as recorded, stamps too, as they were recorded."""
    tf = pytest.importorskip("tf2_msgs.msg", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")
    path, motion = bag
    states, directions, times, places, transforms = [], [], [], [], []
    node = peer.node
    subscriptions = [
        node.create_subscription(kind, topic, take, 100)
        for kind, topic, take in (
            (JointState, "/arm/joints", lambda m: (states.append(m), times.append(time.monotonic()))),
            (Vector3Stamped, "/gravity", directions.append),
            (Odometry, "/odom", places.append),
            (tf.TFMessage, "/tf", transforms.append),
        )
    ]
    player = start("physkin_core.cli", "replay", str(path), "--live")
    received = (states, directions, places, transforms)
    peer.until(lambda: all(len(each) == motion.frame_count for each in received), "all messages")
    assert player.wait(20) == 0
    for subscription in subscriptions:  # another test wants nobody to listen
        node.destroy_subscription(subscription)
    assert player.stdout.read().startswith(f"sent {4 * motion.frame_count} messages: half were at most ")
    np.testing.assert_array_equal([state.position for state in states], motion.positions.astype(np.float64))
    assert states[0].name == list(motion.joint_names)
    stamps = [state.header.stamp.sec + state.header.stamp.nanosec / 1e9 for state in states]
    np.testing.assert_allclose(stamps, 1 + np.arange(motion.frame_count) / 30, atol=1e-6)
    np.testing.assert_allclose([d.vector.z for d in directions], motion.gravity[:, 2])
    np.testing.assert_allclose([place.pose.pose.position.x for place in places], motion.root_position[:, 0])
    (last,) = transforms[-1].transforms
    assert (last.header.frame_id, last.child_frame_id) == ("hall", "torso")
    assert times[-1] - times[0] == pytest.approx((motion.frame_count - 1) / 30, abs=0.2)


@pytest.mark.parametrize("arguments", [["--live", "--fit", "1"], ["--live", "--json", "x.json"]])
def test_options_that_mean_nothing_are_refused(bag, arguments, capsys):
    """Those of draping, while playing."""
    with pytest.raises(SystemExit):
        cli.main(["replay", str(bag[0]), *arguments])
    assert arguments[-2] in capsys.readouterr().err


def test_nobody_listens(bag, domain, monkeypatch, capsys):
    """Told in one line; and that TF is left out where its messages are not installed."""
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", None)
    from physkin_ros.middleware import spinning

    monkeypatch.setattr(spinning, "DISCOVERY_SECONDS", 0.2)
    assert cli.main(["replay", str(bag[0]), "--live"]) == 2
    told = capsys.readouterr().err
    assert "nobody has subscribed to /arm/joints" in told
    assert "/tf and /tf_static, if the bag has them, are not played: tf2_msgs is not installed" in told
