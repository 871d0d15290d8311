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
from physkin_ros.messages.interfaces import missing_tf
from physkin_ros.middleware.spinning import wait_for_subscribers
from physkin_ros.middleware.transport import use_shipped_profile

__all__ = ["main", "play"]

CLASSES = {"joint_state": JointState, "gravity": Vector3Stamped, "odometry": Odometry}
PASSING, LATCHED = QoSProfile(depth=100), QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0."""
    description = __doc__.split("`: ", 1)[1]
    parser = argparse.ArgumentParser(prog="physkin replay --live", description=description)
    parser.add_argument("bag", type=Path, help="folder with metadata.yaml, or a .mcap or .db3 file")
    parser.add_argument("--live", action="store_true", help="play the messages instead of draping them")
    parser.add_argument("--topic", help="topic of joint states (default /joint_states, or the only one)")
    options = parser.parse_args(argv)
    root = ["odometry", "transforms"]
    if missing := missing_tf():
        root.remove("transforms")
        print(f"/tf and /tf_static, if the bag has them, are not played: {missing}", file=sys.stderr)
    with BagReader(options.bag, topic=options.topic, root=root) as bag:
        late = 1e3 * play(bag)
    if not len(late):
        raise BagError(f"bag {bag.path} holds no message on {bag.topic}")
    print(f"sent {len(late)} messages: half were at most {np.median(late):.1f} ms late, all {late.max():.1f} ms")
    return 0


def play(bag: BagReader) -> np.ndarray:
    """Publish the bag's messages, bytes and stamps unchanged, when they were recorded.

    Returns how late each was sent [s], (messages,). Waits for somebody who listens to the joint states, and at the end
    until everything has arrived. Raises TimeoutError when nobody listens, and BagError when the bag cannot be read on.
    """
    use_shipped_profile()
    rclpy.init(args=[])
    node = rclpy.create_node("physkin_replay")
    classes = dict(CLASSES)
    if "transforms" in bag.topics.values():
        from tf2_msgs.msg import TFMessage

        classes["transforms"] = TFMessage
    try:
        publishers = {
            topic: node.create_publisher(classes[kind], topic, LATCHED if topic == "/tf_static" else PASSING)
            for topic, kind in bag.topics.items()
        }
        wait_for_subscribers(publishers[bag.topic])
        late, begin, first = [], time.monotonic(), None
        for message in bag:
            first = message.time_ns if first is None else first
            due = begin + (message.time_ns - first) / 1e9
            time.sleep(max(0.0, due - time.monotonic()))
            late.append(time.monotonic() - due)
            publishers[message.topic].publish(message.data)
        for publisher in publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=5))
        return np.array(late)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
