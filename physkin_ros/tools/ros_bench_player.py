"""Publisher process of `physkin ros-bench`: joint states of several avatars at a fixed rate, stamped when sent.

Dimensions: `K` avatars, `T` joint states of each. Times are CLOCK_MONOTONIC, which a machine's processes share [ns].
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from array import array
from pathlib import Path

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from physkin_core import load_motion
from physkin_ros.messages.serialised import SerialisedMessage
from physkin_ros.middleware.subscriber_discovery import wait_for_subscribers
from physkin_ros.tools.machine import cpu_seconds

__all__ = ["MOTION", "main", "play"]

MOTION = "dance"
MARKER = 1.2345678e-300
WARM_UP_SECONDS = 1.0
DRAIN_SECONDS = 0.3  # for what is on its way when the last joint state is out


def play(node, rate: float, seconds: float, avatars: int, watched: int) -> dict[str, np.ndarray]:
    """Publish on `a0/joint_states` and so on, the avatars' joint states evenly spread over each period.

    watched: id of the process whose processor time is taken.
    Returns stamps (T, K) [ns] of what came after the warm-up, cpu (2,) [s] that the first thread of `watched` and all
    its threads used for them, and load (2,), the load average of a minute before and after.
    Raises TimeoutError when nobody listens.
    """
    motion = load_motion(MOTION).resampled(rate)
    frames = motion.positions.astype(np.float64)
    publishers = [
        node.create_publisher(JointState, f"a{index}/joint_states", QoSProfile(depth=100)) for index in range(avatars)
    ]
    wait_for_subscribers(*publishers)
    marker = np.full(len(motion.joint_names), MARKER)
    message = SerialisedMessage(JointState(name=list(motion.joint_names), position=array("d", marker.tolist())), marker)
    warm_up, count = round(WARM_UP_SECONDS * rate), round(seconds * rate)
    stamps = np.empty((warm_up + count, avatars), dtype=np.int64)
    load = [os.getloadavg()[0]]
    start, before = time.monotonic(), (0.0, 0.0)
    for tick in range(warm_up + count):
        if tick == warm_up:
            before = cpu_seconds(watched)
        message.payload[:] = frames[tick % len(frames)]
        for index, publisher in enumerate(publishers):
            time.sleep(max(0.0, start + (tick + index / avatars) / rate - time.monotonic()))
            stamps[tick, index] = now = time.monotonic_ns()
            publisher.publish(message.stamped(*divmod(now, 1_000_000_000)))
    time.sleep(DRAIN_SECONDS)
    cpu = np.subtract(cpu_seconds(watched), before)
    return {"stamps": stamps[warm_up:], "cpu": cpu, "load": np.array([*load, os.getloadavg()[0]])}


def main() -> int:
    """Command line: RATE SECONDS AVATARS PID OUTPUT.npz; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rate", type=float)
    parser.add_argument("seconds", type=float)
    parser.add_argument("avatars", type=int)
    parser.add_argument("pid", type=int, help="of the node")
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    rclpy.init(args=[])
    node = rclpy.create_node("ros_bench_player")
    try:
        np.savez(arguments.output, **play(node, arguments.rate, arguments.seconds, arguments.avatars, arguments.pid))
    except (TimeoutError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
