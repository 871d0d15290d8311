"""Third process of the demo: receives the garment clouds, checks them and writes down when each came.

Dimensions: `R` received clouds, `k` kept clouds, `n` garment vertices. Times are CLOCK_MONOTONIC [ns].
"""

from __future__ import annotations

import argparse
import json
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

from physkin_ros.messages.conversions import read_cloud
from physkin_ros.middleware.spinning import spin_until

__all__ = ["KEPT_CLOUDS", "READY", "Listener", "main"]

READY = "ready"
"""Printed once the garment's publisher has been found."""
KEPT_CLOUDS = 8
DISCOVERY_SECONDS = 60.0
FIRST_CLOUD_SECONDS = 60.0
SILENCE_SECONDS = 3.0
LAST_REPORT_SECONDS = 2.5


class Listener(Node):
    """Collects what arrives on `drape_node/garment` and `/diagnostics`.

    keep_every: of every so many clouds one is kept with its points, KEPT_CLOUDS at most.
    """

    def __init__(self, keep_every: int) -> None:
        super().__init__("demo_listener")
        self.stamps: list[int] = []
        self.received: list[int] = []
        self.finite: list[bool] = []
        self.kept: dict[int, np.ndarray] = {}
        self.reports: list[dict[str, str]] = []
        self._keep_every = keep_every
        # deep queues: the demo counts what is lost on the way, not what a busy machine reads late
        self.subscription = self.create_subscription(
            PointCloud2, "drape_node/garment", self._on_cloud, QoSProfile(depth=1000)
        )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_cloud(self, message: PointCloud2) -> None:
        self.received.append(time.monotonic_ns())
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        points = read_cloud(message)
        self.stamps.append(stamp)
        self.finite.append(bool(np.isfinite(points).all()))
        if (len(self.stamps) - 1) % self._keep_every == 0 and len(self.kept) < KEPT_CLOUDS:
            self.kept[stamp] = points.copy()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.reports.append({value.key: value.value for value in status.values})

    def reported(self, count: int) -> bool:
        """Whether the node has reported on at least `count` clouds."""
        return bool(self.reports) and int(self.reports[-1]["clouds published"]) >= count

    def save(self, path: Path) -> None:
        """Write stamps, receipt times (R,) [ns], finite (R,), kept_stamps (k,), kept (k, n, 6) and the reports."""
        np.savez(
            path,
            stamps=np.array(self.stamps, dtype=np.int64),
            received=np.array(self.received, dtype=np.int64),
            finite=np.array(self.finite, dtype=bool),
            kept_stamps=np.array(list(self.kept), dtype=np.int64),
            kept=np.array(list(self.kept.values()), dtype=np.float32),
            reports=json.dumps(self.reports),
        )


def main() -> int:
    """Command line: EXPECTED KEEP_EVERY OUTPUT.npz; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("expected", type=int, help="number of clouds after which to stop")
    parser.add_argument("keep_every", type=int, help="clouds from one whose points are kept to the next")
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    rclpy.init(args=[])
    executor = EventsExecutor()
    listener = Listener(arguments.keep_every)
    executor.add_node(listener)
    try:
        if not spin_until(executor, DISCOVERY_SECONDS, lambda: listener.subscription.get_publisher_count() > 0):
            print("error: the garment's publisher did not appear", file=sys.stderr)
            return 2
        print(READY, flush=True)
        spin_until(executor, FIRST_CLOUD_SECONDS, lambda: listener.stamps)
        count = -1
        while count < len(listener.stamps) < arguments.expected:  # until all are here, or none comes any more
            count = len(listener.stamps)
            spin_until(executor, SILENCE_SECONDS, lambda: len(listener.stamps) >= arguments.expected)
        spin_until(executor, LAST_REPORT_SECONDS, lambda: listener.reported(len(listener.stamps)))
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
