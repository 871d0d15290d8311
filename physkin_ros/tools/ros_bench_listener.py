"""Reader process of `physkin ros-bench`: writes down when each cloud came, as the bytes it travelled as.

Dimensions: `R` received clouds. Times are CLOCK_MONOTONIC [ns].
"""

from __future__ import annotations

import argparse
import struct
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from physkin_ros.middleware.spinning import spin_until

__all__ = ["READY", "BenchListener", "main"]

READY = "ready"
"""Printed once the node has reported that every garment is there."""
DISCOVERY_SECONDS = 60.0
FIRST_CLOUD_SECONDS = 60.0
SILENCE_SECONDS = 1.5
STAMP = struct.Struct("=iI")


class BenchListener(Node):
    """Listens to the garments of `avatars` avatars, and to the node's reports."""

    def __init__(self, avatars: int) -> None:
        super().__init__("ros_bench_listener")
        self.avatars: list[int] = []
        self.stamps: list[bytes] = []
        self.received: list[int] = []
        self.evaluations: list[tuple[float, float]] = []
        self.ready = False
        self._count = avatars
        # deep queues: what is lost on the way is counted, not what a busy machine reads late
        self.subscriptions_to_clouds = [
            self.create_subscription(
                PointCloud2,
                f"drape_node/a{index}/g/garment",
                lambda data, index=index: self._on_cloud(index, data),
                QoSProfile(depth=1000),
                raw=True,
            )
            for index in range(avatars)
        ]
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_cloud(self, index: int, data: bytes) -> None:
        self.received.append(time.monotonic_ns())
        self.stamps.append(data[4:12])
        self.avatars.append(index)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        found = all(each.get_publisher_count() for each in self.subscriptions_to_clouds)
        loaded = [status for status in message.status if "loaded" not in status.message]
        self.ready = self.ready or (found and len(loaded) == self._count)
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            if values["evaluation p50 [us]"] != "none":
                self.evaluations.append((float(values["evaluation p50 [us]"]), float(values["evaluation p99 [us]"])))

    def save(self, path: Path) -> None:
        """Write avatars, stamps and receipt times (R,), and evaluations (seconds x garments, 2) p50 and p99 [us]."""
        stamps = [sec * 1_000_000_000 + nanosec for sec, nanosec in map(STAMP.unpack, self.stamps)]
        np.savez(
            path,
            avatars=np.array(self.avatars, dtype=np.int64),
            stamps=np.array(stamps, dtype=np.int64),
            received=np.array(self.received, dtype=np.int64),
            evaluations=np.array(self.evaluations, dtype=np.float64).reshape(-1, 2),
        )


def main() -> int:
    """Command line: AVATARS OUTPUT.npz; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("avatars", type=int)
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    rclpy.init(args=[])
    executor = EventsExecutor()
    listener = BenchListener(arguments.avatars)
    executor.add_node(listener)
    try:
        if not spin_until(executor, DISCOVERY_SECONDS, lambda: listener.ready):
            print("error: the node did not report its garments", file=sys.stderr)
            return 2
        print(READY, flush=True)
        spin_until(executor, FIRST_CLOUD_SECONDS, lambda: listener.stamps)
        count = -1
        while count < len(listener.stamps):
            count = len(listener.stamps)
            spin_until(executor, SILENCE_SECONDS, lambda: False)
        listener.save(arguments.output)
        return 0
    except KeyboardInterrupt:
        return 130
    finally:
        executor.remove_node(listener)
        listener.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
