"""Player process of a trial: sends a motion to every avatar at a fixed rate, and writes down when.

Dimensions: `K` avatars, `T` joint states of each. Times are CLOCK_MONOTONIC, which a machine's processes share [ns].
"""

from __future__ import annotations

import argparse
import os
import struct
import sys
import time
from array import array
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from physkin_core import Motion, load_motion
from physkin_ros.middleware.spinning import wait_for_subscribers

__all__ = ["STAMP", "STAMP_OFFSET", "cpu_seconds", "main", "play"]

STAMP = struct.Struct("=iI")
STAMP_OFFSET = 4  # after the encapsulation, in any message that begins with a header
DRAIN_SECONDS = 0.3  # for what is on its way when the last joint state is out


def play(
    node, motion: Motion, avatars: int, *, gravity: bool = False, warm_up: int = 0, watched: int = 0
) -> dict[str, np.ndarray]:
    """Publish `motion` on `a0/joint_states` and so on, the avatars' joint states evenly spread over each period.

    gravity: send its direction on `a0/gravity` before each. watched: process whose processor time is taken, 0 for none.
    Returns stamps (T, K) [ns], taken right before sending; cpu (2,) [s] that the first thread of `watched` and all its
    threads used after the first `warm_up` joint states; and load, the machine's load average of a minute at the end.
    Waits for subscribers first, and at the end until everything has arrived. Raises TimeoutError when nobody listens.
    """
    quality = QoSProfile(depth=100)
    publishers = [node.create_publisher(JointState, f"a{k}/joint_states", quality) for k in range(avatars)]
    downs = [node.create_publisher(Vector3Stamped, f"a{k}/gravity", quality) for k in range(avatars * gravity)]
    wait_for_subscribers(*publishers, *downs)
    stamps = np.empty((motion.frame_count, avatars), dtype=np.int64)
    message, cpu = JointState(name=list(motion.joint_names)), np.zeros(2)
    start = time.monotonic()
    for tick, (positions, (x, y, z)) in enumerate(zip(motion.positions.astype(np.float64), motion.gravity.tolist())):
        if watched and tick == warm_up:
            cpu = np.array(cpu_seconds(watched))
        message.position = array("d", positions.tolist())
        state = bytearray(serialize_message(message))
        down = bytearray(serialize_message(Vector3Stamped(vector=Vector3(x=x, y=y, z=z))))
        for k, publisher in enumerate(publishers):
            time.sleep(max(0.0, start + (tick + k / avatars) / motion.rate_hz - time.monotonic()))
            stamps[tick, k] = now = time.monotonic_ns()
            if gravity:  # first: a joint state is draped with the latest
                downs[k].publish(_stamped(down, now))
            publisher.publish(_stamped(state, now))
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=5))
    time.sleep(DRAIN_SECONDS)
    if watched:
        cpu = np.subtract(cpu_seconds(watched), cpu)
    return {"stamps": stamps, "cpu": cpu, "load": np.array(os.getloadavg()[0])}


def cpu_seconds(pid: int) -> tuple[float, float]:
    """Processor time [s] of a process's first thread and of all its living threads. Linux only: raises OSError."""
    total = 0.0
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            total += int((task / "schedstat").read_text().split()[0]) / 1e9
        except FileNotFoundError:  # the thread has ended meanwhile
            continue
    first = int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[0]) / 1e9
    return first, total


def _stamped(data: bytearray, time_ns: int) -> bytes:
    STAMP.pack_into(data, STAMP_OFFSET, *divmod(time_ns, 1_000_000_000))
    return bytes(data)


def main() -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, help="what `play` returns, .npz")
    parser.add_argument("avatars", type=int)
    parser.add_argument("motion")
    parser.add_argument("rate", type=float)
    parser.add_argument("seconds", type=float)
    parser.add_argument("--warm-up", type=int, default=0)
    parser.add_argument("--watched", type=int, default=0)
    parser.add_argument("--gravity", action="store_true")
    options = parser.parse_args()
    try:
        motion = load_motion(options.motion).resampled(options.rate).looped(options.seconds)
        rclpy.init(args=[])
        chosen = {"gravity": options.gravity, "warm_up": options.warm_up, "watched": options.watched}
        played = play(rclpy.create_node("player"), motion, options.avatars, **chosen)
        np.savez(options.output, **played)
    except (ValueError, TimeoutError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
