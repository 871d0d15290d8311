"""Listener process of a trial: makes sure that every garment answers, then writes down when each cloud came.

Dimensions: `R` received clouds, `k` kept poses, `n` vertices given of all garments of an avatar. Times are
CLOCK_MONOTONIC [ns].
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from array import array
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, PointCloud2

from physkin_core import Motion, load_motion
from physkin_ros.messages.conversions import read_cloud
from physkin_ros.messages.topics import DIAGNOSTICS
from physkin_ros.middleware.spinning import spin_until
from physkin_ros.tools.player import STAMP, STAMP_OFFSET

__all__ = ["READY", "Listener", "garment_names", "main"]

READY = "ready"
"""Printed once every garment has answered a joint state: what is sent from then on and does not come back is lost."""
ANSWER_SECONDS = 90.0
PROBE_PERIOD = 0.2
SILENCE_SECONDS = 1.5
KEPT_CLOUDS = 8


def garment_names(count: int) -> list[str]:
    """What the garments of an avatar are called in a trial: g, g1, g2, ..."""
    return ["g", *(f"g{k}" for k in range(1, count))]


class Listener(Node):
    """Collects what arrives on `drape_node/a0/g/garment`, that of the other `avatars` and garments, and `/diagnostics`.

    motion: whose first pose is sent to ask whether anybody answers. garments: of each avatar. keep_every: of every so
    many answered joint states one is kept with the points of its clouds, and all are checked to be finite; 0: none.
    """

    def __init__(self, avatars: int, motion: Motion, *, garments: int = 1, keep_every: int = 0) -> None:
        super().__init__("listener")
        self.clouds: list[tuple[int, int, int, int]] = []
        self._answered: dict[int, int] = {}
        self._kept: dict[int, dict[int, np.ndarray]] = {}
        self._garments = garments
        self.not_finite = 0
        self.reports: list[dict[str, str]] = []
        self._keep_every = keep_every
        self._probe = JointState(name=list(motion.joint_names), position=array("d", motion.positions[0].tolist()))
        self._probes: set[int] = set()
        self._silent = {(avatar, garment) for avatar in range(avatars) for garment in range(garments)}
        names = garment_names(garments)
        for key in sorted(self._silent):  # deep queues: what is lost on the way is counted, not what is read late
            topic, quality = f"drape_node/a{key[0]}/{names[key[1]]}/garment", QoSProfile(depth=1000)
            self.create_subscription(
                PointCloud2, topic, lambda data, key=key: self._on_cloud(*key, data), quality, raw=True
            )
        self.create_subscription(DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, 10)

    def wait_until_answered(self, executor: Executor, seconds: float) -> bool:
        """Send joint states until each garment has answered one; whether all did within `seconds`.

        Discovery does not tell: a garment may still be loading, and its publisher may not know of this reader yet.
        """
        avatars = {avatar for avatar, _ in self._silent}
        publishers = {k: self.create_publisher(JointState, f"a{k}/joint_states", 1) for k in sorted(avatars)}

        def ask() -> None:
            for k in {avatar for avatar, _ in self._silent}:
                stamp, now = self._probe.header.stamp, time.monotonic_ns()
                stamp.sec, stamp.nanosec = divmod(now, 1_000_000_000)
                self._probes.add(now)
                publishers[k].publish(self._probe)

        timer = self.create_timer(PROBE_PERIOD, ask)
        answered = spin_until(executor, seconds, lambda: not self._silent)
        self.destroy_timer(timer)
        for publisher in publishers.values():
            self.destroy_publisher(publisher)
        self.reports.clear()
        return answered

    def _on_cloud(self, avatar: int, garment: int, data: bytes) -> None:
        received = time.monotonic_ns()
        sec, nanosec = STAMP.unpack_from(data, STAMP_OFFSET)
        stamp = sec * 1_000_000_000 + nanosec
        if stamp in self._probes:
            self._silent.discard((avatar, garment))
            return
        if self._keep_every:
            points = read_cloud(deserialize_message(data, PointCloud2))
            self.not_finite += not np.isfinite(points).all()
            index = self._answered.setdefault(stamp, len(self._answered))
            if index % self._keep_every == 0 and index // self._keep_every < KEPT_CLOUDS:
                self._kept.setdefault(stamp, {})[garment] = points.copy()
        self.clouds.append((avatar, garment, stamp, received))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.reports += [{value.key: value.value for value in status.values} for status in message.status]

    def save(self, path: Path) -> None:
        """Write avatars, garments, received_stamps and received (R,), not_finite, kept_stamps (k,), kept (k, n, 6) of
        the joint states that all garments have answered, one garment's points after the other's, and reports."""
        avatars, garments, stamps, received = np.array(self.clouds, dtype=np.int64).reshape(-1, 4).T
        whole = {stamp: clouds for stamp, clouds in self._kept.items() if len(clouds) == self._garments}
        kept = [np.concatenate([clouds[k] for k in range(self._garments)]) for clouds in whole.values()]
        np.savez(
            path,
            avatars=avatars,
            garments=garments,
            received_stamps=stamps,
            received=received,
            not_finite=self.not_finite,
            kept_stamps=np.array(list(whole), dtype=np.int64),
            kept=np.array(kept, dtype=np.float32),
            reports=json.dumps(self.reports),
        )


def main() -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, help="what `Listener.save` writes, .npz")
    parser.add_argument("avatars", type=int)
    parser.add_argument("motion", help="whose joints are sent")
    parser.add_argument("sent", type=Path, help="what the player writes when it has ended")
    parser.add_argument("--garments", type=int, default=1)
    parser.add_argument("--keep-every", type=int, default=0)
    options = parser.parse_args()
    rclpy.init(args=[])
    executor = EventsExecutor()
    chosen = {"garments": options.garments, "keep_every": options.keep_every}
    listener = Listener(options.avatars, load_motion(options.motion), **chosen)
    executor.add_node(listener)
    try:
        if not listener.wait_until_answered(executor, ANSWER_SECONDS):
            print("error: the node did not answer joint states", file=sys.stderr)
            return 2
        print(READY, flush=True)
        count = -1
        while rclpy.ok() and (count < len(listener.clouds) or not options.sent.exists()):
            count = len(listener.clouds)
            spin_until(executor, SILENCE_SECONDS, lambda: False)
        listener.save(options.output)
        return 0
    except KeyboardInterrupt:
        return 130
    finally:
        executor.remove_node(listener)
        listener.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
