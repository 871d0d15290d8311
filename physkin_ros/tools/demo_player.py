"""Second process of the demo: plays a motion at a fixed rate, gravity and joint states, and writes down when.

Dimensions: `T` joint states. Times are CLOCK_MONOTONIC, which all processes of a machine share [ns].
"""

from __future__ import annotations

import argparse
import sys
import time
from array import array
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3Stamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from physkin_core import Motion, load_motion
from physkin_ros.middleware.subscriber_discovery import wait_for_subscribers

__all__ = ["RATE_HZ", "main", "play"]

RATE_HZ = 60.0


def play(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Publish `motion` on `gravity` and `joint_states`, each frame at its own deadline.

    Returns stamps and sending times (T,) [ns] of the joint states. Waits for a subscriber first, and at the end until
    everything has arrived. Raises TimeoutError when nobody listens.
    """
    node = rclpy.create_node("demo_player")
    try:
        publisher = node.create_publisher(JointState, "joint_states", QoSProfile(depth=100))
        gravity_publisher = node.create_publisher(Vector3Stamped, "gravity", QoSProfile(depth=100))
        wait_for_subscribers(publisher, gravity_publisher)
        frames = [array("d", frame) for frame in motion.positions.astype(np.float64).tolist()]
        directions = motion.gravity.astype(np.float64).tolist()
        tilt = Vector3Stamped()
        message = JointState(name=list(motion.joint_names))
        stamps = np.empty(len(frames), dtype=np.int64)
        sent = np.empty(len(frames), dtype=np.int64)
        start = time.monotonic()
        for index, frame in enumerate(frames):
            time.sleep(max(0.0, start + index / motion.rate_hz - time.monotonic()))
            stamp = node.get_clock().now()
            message.header.stamp = tilt.header.stamp = stamp.to_msg()
            message.position = frame
            tilt.vector.x, tilt.vector.y, tilt.vector.z = directions[index]
            gravity_publisher.publish(tilt)  # first: a joint state is draped with the latest
            stamps[index], sent[index] = stamp.nanoseconds, time.monotonic_ns()
            publisher.publish(message)
        publisher.wait_for_all_acked(Duration(seconds=5))
        return stamps, sent
    finally:
        node.destroy_node()


def main() -> int:
    """Command line: MOTION SECONDS OUTPUT.npz; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("motion")
    parser.add_argument("seconds", type=float)
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    try:
        motion = load_motion(arguments.motion).resampled(RATE_HZ).looped(arguments.seconds)
        rclpy.init(args=[])
        stamps, sent = play(motion)
    except (ValueError, TimeoutError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()
    np.savez(arguments.output, stamps=stamps, sent=sent)
    return 0


if __name__ == "__main__":
    sys.exit(main())
