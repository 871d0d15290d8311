"""`physkin replay --live`: a bag's joint states, gravity and root, played to their topics as they were recorded."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState

from physkin_core.motion.bag_reader import BagError, BagReader
from physkin_ros.arguments import positive
from physkin_ros.messages.interfaces import missing_tf
from physkin_ros.middleware.spinning import wait_for_subscribers
from physkin_ros.middleware.transport import use_shipped_profile

__all__ = ["main", "play"]

PASSING, LATCHED = QoSProfile(depth=100), QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0."""
    parser = argparse.ArgumentParser(
        prog="physkin replay --live", description=__doc__.split("`: ", 1)[1].splitlines()[0]
    )
    parser.add_argument("bag", type=Path, help="folder with metadata.yaml, or a .mcap or .db3 file")
    parser.add_argument("--live", action="store_true", help="play the messages instead of draping them")
    parser.add_argument(
        "--rate", type=positive, default=1.0, metavar="R", help="speed: 2 plays twice as fast (default 1)"
    )
    parser.add_argument("--topic", help="topic of joint states (default /joint_states, or the only one)")
    parser.add_argument(
        "--gravity-topic", help="topic of the direction of gravity (default /gravity, if the bag has it)"
    )
    options = parser.parse_args(argv)
    root = ["odometry", "transforms"]
    if missing := missing_tf():
        root.remove("transforms")
        print(f"/tf and /tf_static, if the bag has them, are not played: {missing}", file=sys.stderr)
    with BagReader(options.bag, topic=options.topic, orientation_topic=options.gravity_topic, root=root) as bag:
        late = 1e3 * play(bag, rate=options.rate)
    if not len(late):
        raise BagError(f"bag {bag.path} holds no message on {bag.topic}")
    p50, p99 = np.percentile(late, (50, 99))
    print(f"sent {len(late)} messages: half were at most {p50:.1f} ms late, 99 % {p99:.1f} ms, all {late.max():.1f} ms")
    return 0


def play(bag: BagReader, *, rate: float = 1.0) -> np.ndarray:
    """Publish the bag's messages, bytes and stamps unchanged, `rate` times as fast as they were recorded.

    Returns how late each was sent [s], (messages,). Waits for somebody who listens to the joint states, and at the end
    until everything has arrived. Raises TimeoutError when nobody listens, and BagError when the bag cannot be read on.
    """
    use_shipped_profile()
    rclpy.init(args=[])
    node = rclpy.create_node("physkin_replay")
    try:
        publishers = {
            topic: node.create_publisher(_message(kind), topic, LATCHED if topic == "/tf_static" else PASSING)
            for topic, kind in bag.topics.items()
        }
        wait_for_subscribers(publishers[bag.topic])
        late, begin, first = [], time.monotonic(), None
        for message in bag:
            first = message.time_ns if first is None else first
            due = begin + (message.time_ns - first) / 1e9 / rate
            time.sleep(max(0.0, due - time.monotonic()))
            late.append(time.monotonic() - due)
            publishers[message.topic].publish(message.data)
        for publisher in publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=5))
        return np.array(late)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _message(kind: str) -> type:
    """The class of what a bag's messages are of."""
    if kind == "transforms":
        from tf2_msgs.msg import TFMessage

        return TFMessage
    return {"joint_state": JointState, "gravity": Vector3Stamped, "odometry": Odometry}[kind]
