"""A ROS node of the tests' own that talks to a drape node in another process, and GLB files taken apart."""

from __future__ import annotations

import json
import struct
import subprocess
import time
from array import array
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from physkin_msgs.msg import DrapeStatistics, GarmentMesh
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, PointCloud2

from physkin_ros.messages.conversions import read_cloud


class Site:
    """A drape node's process and a ROS node to talk to it. garments: "avatar/garment", those to listen to.

    log: file of what the process says. clouds: (garment, stamp) -> points and frame. statuses: garment -> values of the
    latest diagnostics.
    """

    def __init__(
        self, domain: int, process: subprocess.Popen, garments: Iterable[str], log: Path | None = None
    ) -> None:
        self.process, self.log = process, log
        self.context = rclpy.Context()
        rclpy.init(context=self.context, args=[], domain_id=domain)
        self.node = rclpy.create_node("site", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.clouds, self.statuses, self.statistics, self.meshes = {}, {}, [], {}
        self._publishers, self._clients, self.stamp = {}, {}, 0
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.node.create_subscription(DrapeStatistics, "/drape_node/statistics", self.statistics.append, 10)
        for garment in garments:
            self.listen(garment)

    def listen(self, garment: str) -> None:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

        def on_cloud(message) -> None:
            key = garment, (message.header.stamp.sec, message.header.stamp.nanosec)
            self.clouds[key] = read_cloud(message).copy(), message.header.frame_id

        self.node.create_subscription(PointCloud2, f"/drape_node/{garment}/garment", on_cloud, 1000)
        self.node.create_subscription(
            GarmentMesh, f"/drape_node/{garment}/mesh", lambda mesh: self.meshes.__setitem__(garment, mesh), latched
        )

    def _on_diagnostics(self, message) -> None:
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            self.statuses[status.name.removeprefix("drape_node: ")] = values | {"summary": status.message}

    def publisher(self, topic: str, kind=JointState):
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind, topic, 10)
            self.until(lambda: self._publishers[topic].get_subscription_count(), f"subscription to {topic}")
            self.spin(0.2)
        return self._publishers[topic]

    def state(self, names, positions) -> JointState:
        message = JointState(name=list(names), position=array("d", [float(value) for value in positions]))
        self.stamp += 1
        message.header.stamp.sec = self.stamp
        return message

    def cloud(self, garment: str, names, positions, topic: str | None = None) -> np.ndarray:
        """What a joint state is answered with."""
        message = self.state(names, positions)
        self.publisher(topic or f"/{garment.split('/')[0]}/joint_states").publish(message)
        key = garment, (self.stamp, 0)
        self.until(lambda: key in self.clouds, f"cloud {key}")
        return self.clouds[key][0]

    def call(self, kind, name: str, **fields):
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"/drape_node/{name}")
            self.until(self._clients[name].service_is_ready, name)
        future = self._clients[name].call_async(kind.Request(**fields))
        self.until(future.done, f"answer of {name}")
        return future.result()

    def until(self, done, what: str, seconds: float = 20.0) -> None:
        deadline = time.monotonic() + seconds
        while not done():
            assert self.process.poll() is None, f"the node ended while waiting for {what}"
            assert time.monotonic() < deadline, f"no {what} within {seconds:.0f} s"
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def glb_parts(glb: bytes) -> tuple[dict, bytes]:
    """A GLB's JSON and what follows it."""
    length = struct.unpack_from("<I", glb, 12)[0]
    return json.loads(glb[20 : 20 + length]), glb[20 + length :]


def glb_joined(document: dict, rest: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return (
        struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + rest
    )
