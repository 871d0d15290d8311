"""Fixtures of the ROS tests: private ROS domains, processes that end with the test, and a peer to talk to."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from physkin_core import save_garment_model


@pytest.fixture(scope="session")
def leaning_model(garment_model):
    """The test's garment, but of a cloth that swings by centimetres when the body leans."""
    (weight, bias), *layers = garment_model.pose_modulator
    weight = weight.copy()
    weight[:, -3:] *= 1000  # the end of the pose vector is gravity
    return dataclasses.replace(garment_model, pose_modulator=((weight, bias), *layers))


@pytest.fixture(scope="session")
def leaning_model_path(leaning_model, tmp_path_factory):
    """A file of it."""
    path = tmp_path_factory.mktemp("models") / "leaning.safetensors"
    save_garment_model(leaning_model, path)
    return path


@pytest.fixture(scope="session", autouse=True)
def domains_of_this_process():
    """Of processes that run tests side by side, each chooses among other ROS domains."""
    from physkin_ros.middleware import transport

    index, count = (
        os.environ.get(f"PYTEST_XDIST_WORKER{end}", default) for end, default in (("", "gw0"), ("_COUNT", "1"))
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transport, "DOMAINS", transport.DOMAINS[int(index.removeprefix("gw")) :: int(count)])
        yield


@pytest.fixture(scope="module")
def domain():
    """A ROS domain of the module's own for this process and its children, on this machine only."""
    from physkin_ros.middleware.transport import private_environment

    with pytest.MonkeyPatch.context() as patch:
        for name, value in private_environment().items():
            if os.environ.get(name) != value:
                patch.setenv(name, value)
        yield int(os.environ["ROS_DOMAIN_ID"])


@pytest.fixture(scope="module")
def start_site(domain, tmp_path_factory):
    """Starts `physkin node --config` with these parameters, and a ROS node that listens to these garments.

    At the end the node must still be there, end well at SIGINT and have logged no traceback.
    """
    sites = []

    def start(parameters: dict, garments):
        import yaml
        from drape_site import Site

        folder = tmp_path_factory.mktemp("site")
        config, log = folder / "avatars.yaml", folder / "log"
        config.write_text(yaml.safe_dump({"drape_node": {"ros__parameters": parameters}}))
        command = [sys.executable, "-m", "physkin_core.cli", "node", "--config", str(config)]
        with open(log, "w") as output:
            process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        sites.append(Site(domain, process, garments, log))
        return sites[-1]

    yield start
    try:
        for site in sites:
            site.process.send_signal(signal.SIGINT)
            assert site.process.wait(10) == 0, site.log.read_text()
            assert "Traceback" not in site.log.read_text()
    finally:
        for site in sites:
            site.process.kill()
            site.process.wait()
            site.close()


@pytest.fixture
def start(domain):
    """Starts `python -m MODULE ARGUMENT...` in the domain; whatever still runs at the end is ended."""
    processes = []

    def start_module(module: str, *arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", module, *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        processes.append(process)
        return process

    yield start_module
    for process in processes:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
        process.stdout.close()


@pytest.fixture(scope="module")
def module_peer(domain):
    """The peer of all tests of a module."""
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
    peer = Peer(domain)
    yield peer
    peer.close()


@pytest.fixture
def peer(module_peer):
    """A ROS node of the tests' own that sends joint states and gravity, and collects what the drape node publishes."""
    for collected in (module_peer.clouds, module_peer.frame_ids, module_peer.reports):
        collected.clear()
    return module_peer


class Peer:
    """clouds: stamp (sec, nanosec) -> points (n, 6). reports: values of each diagnostics message by name."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import Vector3Stamped
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState, PointCloud2

        self.context = rclpy.Context()
        rclpy.init(context=self.context, args=[], domain_id=domain)
        self.node = rclpy.create_node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.clouds: dict[tuple[int, int], np.ndarray] = {}
        self.frame_ids: set[str] = set()
        self.reports: list[dict[str, str]] = []
        self._joint_state, self._vector = JointState, Vector3Stamped
        self._gravity_publisher = self.node.create_publisher(Vector3Stamped, "gravity", 10)
        self._publisher = self.node.create_publisher(JointState, "joint_states", 10)
        self._subscription = self.node.create_subscription(PointCloud2, "drape_node/garment", self._on_cloud, 100)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def send(self, names, positions, stamp: tuple[int, int]) -> None:
        """Publish a joint state."""
        message = self._joint_state(name=list(names), position=[float(value) for value in positions])
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        self._publisher.publish(message)

    def send_gravity(self, direction, stamp: tuple[int, int] = (0, 0)) -> None:
        """Publish the direction of gravity (3,)."""
        message = self._vector()
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        message.vector.x, message.vector.y, message.vector.z = map(float, direction)
        self._gravity_publisher.publish(message)

    def cloud(self, names, positions, stamp: tuple[int, int]) -> np.ndarray:
        """The cloud (n, 6) that a joint state is answered with."""
        self.send(names, positions, stamp)
        self.spin_until(lambda: stamp in self.clouds, f"cloud of {stamp}")
        return self.clouds[stamp]

    def connect(self, *, gravity: bool = True, settle: float = 0.5) -> None:
        """Wait for the drape node. gravity: and for its subscription to that topic. settle: [s] longer."""
        publishers = (self._publisher, self._gravity_publisher) if gravity else (self._publisher,)
        ready = (*(each.get_subscription_count for each in publishers), self._subscription.get_publisher_count)
        self.spin_until(lambda: all(count() for count in ready), "drape node")
        self.spin(settle)

    def latest(self, key: str) -> str:
        """A value of the latest diagnostics."""
        return self.reports[-1][key] if self.reports else ""

    def until_told(self, key: str, text: str) -> None:
        """Wait until the diagnostics say so."""
        self.spin_until(lambda: text in self.latest(key), f"{text!r} as {key}; has {self.reports[-1:]}")

    def spin_until(self, done, what: str, seconds: float = 30.0) -> None:
        """Serve callbacks until `done()`; fails the test after `seconds`."""
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, f"no {what} within {seconds:.0f} s"
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Leave the domain."""
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def _on_cloud(self, message) -> None:
        from physkin_ros.messages.conversions import read_cloud

        self.clouds[message.header.stamp.sec, message.header.stamp.nanosec] = read_cloud(message).copy()
        self.frame_ids.add(message.header.frame_id)

    def _on_diagnostics(self, message) -> None:
        for status in message.status:
            self.reports.append({value.key: value.value for value in status.values} | {"summary": status.message})
