"""What demo and benchmark share: waiting until the node answers, counting, and children that leave nothing behind."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest

from physkin_core import load_motion

rclpy = pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from rclpy.experimental import EventsExecutor  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402

from physkin_ros.messages.conversions import GarmentCloud  # noqa: E402
from physkin_ros.middleware.spinning import spin_until  # noqa: E402
from physkin_ros.middleware.transport import private_environment  # noqa: E402
from physkin_ros.node.config_file import load_config  # noqa: E402
from physkin_ros.tools.children import ChildFailedError, Children  # noqa: E402
from physkin_ros.tools.listener import Listener  # noqa: E402
from physkin_ros.tools.player import play  # noqa: E402
from physkin_ros.tools.trial import Records, start_node  # noqa: E402


class LateGarment:
    """A node that is discovered at once, but answers joint states only once `late` of them have come, as one whose
    garment is still being loaded."""

    def __init__(self, node, late: int) -> None:
        self.asked, self.late = 0, late
        self.cloud = GarmentCloud(3, "base_link")
        self.cloud.points[:] = 1.0
        self.publisher = node.create_publisher(PointCloud2, "drape_node/a0/g/garment", 100)
        node.create_subscription(JointState, "a0/joint_states", self.on_state, 100)

    def on_state(self, state) -> None:
        self.asked += 1
        if self.asked > self.late:
            self.cloud.publish(self.publisher, state.header.stamp.sec, state.header.stamp.nanosec)


@pytest.mark.parametrize("fit", [None, 0.0])
def test_the_node_is_started_as_told(fit, tmp_path):
    """A garment's parameter that is None is left to the node."""
    children = SimpleNamespace(start=lambda *command: None)
    start_node(children, tmp_path, 2, avatar={}, garment={"model": "tshirt", "fit": fit}, queue=None)
    found = load_config(tmp_path / "avatars.yaml").avatars
    assert [(each.id, each.garments[0].model, each.garments[0].fit) for each in found] == [
        ("a0", "tshirt", fit),
        ("a1", "tshirt", fit),
    ]


@pytest.fixture
def executor(domain):
    rclpy.init(args=[], domain_id=domain)
    yield EventsExecutor()
    rclpy.try_shutdown()


def test_nothing_is_lost_between_discovery_and_readiness(executor, tmp_path):
    """A joint state sent before the garment answers would count as lost; questions and answers count as nothing."""
    motion = load_motion("walk").resampled(30.0).looped(0.2)
    node, listener = rclpy.create_node("garment"), Listener(1, motion, keep_every=2)
    garment = LateGarment(node, late=3)
    executor.add_node(node)
    executor.add_node(listener)
    assert listener.wait_until_answered(executor, 20) and garment.asked > 3
    played = {}
    player = Thread(target=lambda: played.update(play(rclpy.create_node("player"), motion, 1, watched=os.getpid())))
    player.start()
    assert spin_until(executor, 20, lambda: not player.is_alive())
    listener.save(tmp_path / "received.npz")
    with np.load(tmp_path / "received.npz") as received:
        records = Records(**played, **received)
    counts, delays = records.answers()
    np.testing.assert_array_equal(counts, np.ones((6, 1)))
    assert len(records.received) == 6 and (delays > 0).all() and records.kept.shape == (3, 3, 6)
    assert 0 < records.cpu[0] <= records.cpu[1]


def test_answers_are_matched_by_avatar_and_stamp(made_records):
    """Whatever order they come in; one that came twice is counted, a lost one has no delay, a stranger is nobody's."""
    records = made_records([1, 2, None, 3, 1, 1], avatars=2, repeated=[5], strangers=2)
    counts, delays = records.answers()
    np.testing.assert_array_equal(counts, [[1, 1], [0, 1], [1, 2]])
    np.testing.assert_array_equal(delays, [[1, 2], [np.nan, 3], [1, 1]])
    np.testing.assert_array_equal(records.evaluations(), [[50, 70], [54, 90], [52, 80]])
    counts, delays = made_records([None, None]).answers()
    assert not counts.any() and np.isnan(delays).all()


def test_child_that_fails_is_heard(tmp_path):
    """Waiting ends at once, with what the child wrote."""
    with Children(os.environ, tmp_path) as children:
        children.start("player", "physkin_ros.tools.player", tmp_path / "sent.npz", 1, "nosuchmotion", 60, 1)
        with pytest.raises(ChildFailedError, match="player ended with status 2:\nerror: .*'nosuchmotion'"):
            children.wait(lambda: False, "a miracle", seconds=30)


def test_killed_child_leaves_no_shared_memory(tmp_path, monkeypatch):
    """One that must be killed cannot tidy up, so its parent does."""
    monkeypatch.setattr("physkin_ros.tools.children.STOP_SECONDS", 0.5)
    with Children(private_environment(), tmp_path) as children:
        children.start(
            "listener", "physkin_ros.tools.listener", tmp_path / "received.npz", 1, "walk", tmp_path / "sent"
        )
        pid = children.pid("listener")
        children.wait(lambda: len(_shared_memory_of(pid)) > 1, "the listener", seconds=60)
        opened = _shared_memory_of(pid)
        os.kill(pid, signal.SIGSTOP)  # deaf to SIGINT, so that it is killed
    assert not Path(f"/proc/{pid}").exists()
    assert not [path for path in opened if path.exists()]


def _shared_memory_of(pid: int) -> set[Path]:
    """The process's own segments, not the ports it may share."""
    words = Path(f"/proc/{pid}/maps").read_text().split()
    return {Path(word) for word in words if word.startswith("/dev/shm/fastrtps_") and "_port" not in word}
