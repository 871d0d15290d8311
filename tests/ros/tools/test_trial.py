"""What the demo is made of: waiting until the node answers, counting, and a node that leaves nothing behind."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from physkin_core import load_motion

rclpy = pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402

from physkin_ros.messages.conversions import GarmentCloud  # noqa: E402
from physkin_ros.tools import trial  # noqa: E402
from physkin_ros.tools.trial import NodeProcess, TrialError, node_parameters, play_to_node  # noqa: E402


class LateGarment:
    """A node that is discovered at once, but answers joint states only once `late` of them have come, as one whose
    garment is still being loaded."""

    def __init__(self, node, late: int) -> None:
        self.asked, self.late = 0, late
        self.cloud = GarmentCloud(3, "base_link")
        self.cloud.points[:] = 1.0
        self.publisher = node.create_publisher(PointCloud2, "drape_node/a0/g0/garment", 100)
        node.create_subscription(JointState, "a0/joint_states", self.on_state, 100)

    def on_state(self, state) -> None:
        self.asked += 1
        if self.asked > self.late:
            self.cloud.publish(self.publisher, state.header.stamp.sec, state.header.stamp.nanosec)


@pytest.fixture
def late_garment(domain):
    """In a context of its own, spun by a thread."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("garment", context=context)
    garment = LateGarment(node, late=3)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    spinning = Thread(target=executor.spin)
    spinning.start()
    yield garment
    executor.shutdown()
    spinning.join()
    node.destroy_node()
    context.try_shutdown()


def test_nothing_is_lost_between_discovery_and_readiness(late_garment):
    """A joint state sent before the garment answers would count as lost; questions and answers count as nothing."""
    motion = load_motion("walk").resampled(30.0).looped(0.2)
    records = play_to_node(motion, keep_every=2, measure=time.monotonic)
    assert late_garment.asked > 3
    np.testing.assert_array_equal(records.counts, np.ones((6, 1, 1)))
    assert (records.delays > 0).all() and records.strangers == records.not_finite == 0
    assert list(records.kept) == [0, 2, 4] and records.kept[0][0].shape == (3, 6)
    before, after = records.measured
    assert 0.1 <= after - before - trial.DRAIN_SECONDS < 10


def test_answers_are_matched_by_avatar_and_stamp(domain):
    """Whatever order they come in; one that came twice is counted, a lost one has no delay, a stranger is nobody's."""
    rclpy.init(args=[], domain_id=domain)
    listener = trial.Listener(2, 1)
    listener.arrived |= {(0, 0, 10): [2_000_010, 3_000_000], (1, 0, 20): [1_000_020], (1, 0, 10): [5], (0, 0, 30): [40]}
    records = listener.records(np.array([[10, 20], [30, 40]]))
    listener.destroy_node()
    rclpy.try_shutdown()
    np.testing.assert_array_equal(records.counts[..., 0], [[2, 1], [1, 0]])
    np.testing.assert_array_equal(records.delays[..., 0], [[2, 1], [1e-5, np.nan]])
    assert records.strangers == 1


def test_a_node_that_fails_is_heard(tmp_path, domain):
    """Waiting ends at once, with what it said."""
    with NodeProcess(node_parameters(1, [{"model": "nosuch"}]), tmp_path) as node:
        with pytest.raises(TrialError, match="the node ended with status 2:\n(?s:.*)nosuch"):
            play_to_node(load_motion("walk"), check=node.check)


def test_killed_node_leaves_no_shared_memory(tmp_path, domain, monkeypatch):
    """One that must be killed cannot tidy up, so its parent does."""
    monkeypatch.setattr(trial, "STOP_SECONDS", 0.5)
    with NodeProcess(node_parameters(1, [{"model": "tshirt"}]), tmp_path) as node:
        end = time.monotonic() + 60
        while len(_shared_memory_of(node.pid)) < 2:
            node.check()
            assert time.monotonic() < end
            time.sleep(0.1)
        opened = _shared_memory_of(node.pid)
        os.kill(node.pid, signal.SIGSTOP)  # deaf to SIGINT, so that it is killed
    assert not Path(f"/proc/{node.pid}").exists()
    assert not [path for path in opened if path.exists()]


def _shared_memory_of(pid: int) -> set[Path]:
    """The process's own segments, not the ports it may share."""
    words = Path(f"/proc/{pid}/maps").read_text().split()
    return {Path(word) for word in words if word.startswith("/dev/shm/fastrtps_") and "_port" not in word}
