"""ROS nodes of the tests' own that talk to drape nodes, and GLB files taken apart."""

from __future__ import annotations

import json
import struct
import subprocess
import time
from array import array
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, PointCloud2

from physkin_core import BUNDLED_AVATAR
from physkin_ros.messages.conversions import read_cloud


class Partner:
    """A ROS node with a context and an executor of its own, which serve callbacks while somebody waits."""

    def __init__(self, domain: int, name: str) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, args=[], domain_id=domain)
        self.node = rclpy.create_node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._clients = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def until(self, done: Callable[[], object], what: str, seconds: float = 30.0) -> None:
        """Serve callbacks until `done()`; fails the test after `seconds`."""
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, f"no {what} within {seconds:.0f} s"
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, kind, name: str, **fields):
        """The answer of a drape node's service."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"/drape_node/{name}")
            self.until(self._clients[name].service_is_ready, name)
        future = self._clients[name].call_async(kind.Request(**fields))
        self.until(future.done, f"answer of {name}")
        return future.result()

    def close(self) -> None:
        """Leave the domain."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.told(status.name, {value.key: value.value for value in status.values} | {"summary": status.message})

    def told(self, name: str, values: dict[str, str]) -> None:
        """What a status of the diagnostics says."""


class Peer(Partner):
    """To talk to a node of one garment.

    clouds: stamp (sec, nanosec) -> points (n, 6). reports: values of each diagnostics message by name.
    """

    def __init__(self, domain: int) -> None:
        super().__init__(domain, "peer")
        self.clouds: dict[tuple[int, int], np.ndarray] = {}
        self.frame_ids: set[str] = set()
        self.reports: list[dict[str, str]] = []
        self._gravity_publisher = self.node.create_publisher(Vector3Stamped, "gravity", 10)
        self._publisher = self.node.create_publisher(JointState, "joint_states", 10)
        self._subscription = self.node.create_subscription(PointCloud2, "drape_node/garment", self._on_cloud, 100)

    def send(self, names, positions, stamp: tuple[int, int]) -> None:
        """Publish a joint state."""
        message = JointState(name=list(names), position=[float(value) for value in positions])
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        self._publisher.publish(message)

    def send_gravity(self, direction, stamp: tuple[int, int] = (0, 0)) -> None:
        """Publish the direction of gravity (3,)."""
        message = Vector3Stamped()
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        message.vector.x, message.vector.y, message.vector.z = map(float, direction)
        self._gravity_publisher.publish(message)

    def cloud(self, names, positions, stamp: tuple[int, int]) -> np.ndarray:
        """The cloud (n, 6) that a joint state is answered with."""
        self.send(names, positions, stamp)
        self.until(lambda: stamp in self.clouds, f"cloud of {stamp}")
        return self.clouds[stamp]

    def connect(self, *, gravity: bool = True, settle: float = 0.5) -> None:
        """Wait for the drape node. gravity: and for its subscription to that topic. settle: [s] longer."""
        publishers = [self._publisher, *([self._gravity_publisher] if gravity else [])]
        ready = (*(each.get_subscription_count for each in publishers), self._subscription.get_publisher_count)
        self.until(lambda: all(count() for count in ready), "drape node")
        self.spin(settle)

    def latest(self, key: str) -> str:
        """A value of the latest diagnostics."""
        return self.reports[-1][key] if self.reports else ""

    def until_told(self, key: str, text: str) -> None:
        """Wait until the diagnostics say so."""
        self.until(lambda: text in self.latest(key), f"{text!r} as {key}; has {self.reports[-1:]}")

    def told(self, name: str, values: dict[str, str]) -> None:
        self.reports.append(values)

    def _on_cloud(self, message: PointCloud2) -> None:
        self.clouds[message.header.stamp.sec, message.header.stamp.nanosec] = read_cloud(message).copy()
        self.frame_ids.add(message.header.frame_id)


class Site(Partner):
    """A drape node's process, of many garments, and a ROS node to talk to it.

    garments: "avatar/garment", those to listen to. log: file of what the process says. clouds: (garment, stamp) ->
    points and frame. statuses: garment -> values of the latest diagnostics.
    """

    def __init__(
        self, domain: int, process: subprocess.Popen, garments: Iterable[str], log: Path | None = None
    ) -> None:
        from physkin_msgs.msg import DrapeStatistics

        super().__init__(domain, "site")
        self.process, self.log = process, log
        self.clouds, self.statuses, self.statistics, self.meshes = {}, {}, [], {}
        self._publishers, self.stamp = {}, 0
        self.node.create_subscription(DrapeStatistics, "/drape_node/statistics", self.statistics.append, 10)
        for garment in garments:
            self.listen(garment)

    def listen(self, garment: str) -> None:
        from physkin_msgs.msg import GarmentMesh

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

        def on_cloud(message) -> None:
            key = garment, (message.header.stamp.sec, message.header.stamp.nanosec)
            self.clouds[key] = read_cloud(message).copy(), message.header.frame_id

        self.node.create_subscription(PointCloud2, f"/drape_node/{garment}/garment", on_cloud, 1000)
        self.node.create_subscription(
            GarmentMesh, f"/drape_node/{garment}/mesh", lambda mesh: self.meshes.__setitem__(garment, mesh), latched
        )

    def told(self, name: str, values: dict[str, str]) -> None:
        self.statuses[name.removeprefix("drape_node: ")] = values

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

    def until(self, done: Callable[[], object], what: str, seconds: float = 60.0) -> None:
        """As of any partner; fails at once when the node has ended."""

        def done_or_over() -> bool:
            assert self.process.poll() is None, f"the node ended while waiting for {what}"
            return done()

        super().until(done_or_over, what, seconds)


def text_parameter(name: str, value: str) -> Parameter:
    """A parameter for `rcl_interfaces/SetParameters`."""
    return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value))


def scaled_body(factor: float) -> bytes:
    """A GLB of the bundled avatar, so many times as large."""
    document, rest = glb_parts(BUNDLED_AVATAR.read_bytes())
    scene = document["scenes"][document.get("scene", 0)]
    document["nodes"].append({"children": scene["nodes"], "scale": [factor] * 3})
    scene["nodes"] = [len(document["nodes"]) - 1]
    return glb_joined(document, rest)


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
