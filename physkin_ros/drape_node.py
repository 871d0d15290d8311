"""The drape node: joint states in, garment point clouds out.

Subscribes to `joint_states` and `gravity`; publishes `~/garment`, `/diagnostics` at 1 Hz and, where `physkin_msgs` is
installed, `~/description` (once, transient local) and `~/nodes`. Topics are renamed by remapping, qualities of service
by `qos_overrides` parameters.
"""

from __future__ import annotations

import logging
import sys
from time import perf_counter_ns

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState, PointCloud2

import physkin_core
from physkin_core import BUNDLED_AVATAR, UPRIGHT_GRAVITY, Draper, load_avatar, load_garment_model
from physkin_ros.conversions import GarmentCloud, JointStateReader, garment_description, gravity_direction
from physkin_ros.diagnostics import DrapeStatistics, contact_values, diagnostic_status
from physkin_ros.joint_map import load_joint_map
from physkin_ros.ros4hri import ROS4HRI, Ros4hriReader
from physkin_ros.transport import use_shipped_profile

try:  # clouds never depend on our own messages
    from physkin_msgs.msg import GarmentDescription, GarmentNodes
except ModuleNotFoundError:
    GarmentDescription = GarmentNodes = None

__all__ = ["PARAMETERS", "DrapeNode", "main", "spin"]

EXECUTORS = {"events": EventsExecutor, "single": SingleThreadedExecutor}
PARAMETERS = {
    "model": ("tshirt", "garment model: a .safetensors file, or the name of a shipped one"),
    "body_mesh": ("", "avatar to dress: a GLB, glTF, VRM, OBJ, PLY or STL file; empty: the bundled avatar"),
    "body_rig": ("", "rig file of a body_mesh that has no skin of its own; empty: NAME.rig.json beside it, if there"),
    "joint_map": (
        "",
        "JSON file from incoming joint names to those of the rig, or ros4hri for bodies of REP-155 (default rig only); "
        "empty: the names are the rig's",
    ),
    "frame_id": ("base_link", "TF frame the clouds are given in: the body's root, X forward, Y left, Z up"),
    "backend": ("native", "evaluator: native (C++) or numpy (readable reference, slow)"),
    "precision": (
        "bf16",
        "of the network weights: fp32, bf16 or int8, each faster and coarser than the last; numpy knows fp32 only",
    ),
    "fit": (
        0.0,
        "0: the garment's one size; 1: made to measure for this body; or between. Above 0 only for models that have "
        "learnt it; the node takes half a second more to start",
    ),
    "push_out": (
        False,
        "move vertices that end up inside the body out of it, in microseconds a frame; the node takes seconds more to "
        "start, and its diagnostics tell what is left inside",
    ),
    "executor": ("events", "rclpy executor: events (least overhead) or single"),
    "gravity": (
        UPRIGHT_GRAVITY.tolist(),
        "direction of gravity in the body's root frame until the topic gravity gives one; may be set while running",
    ),
}
"""Name -> default and description. Only `gravity` can change while the node runs."""
TOPICS = {
    "joint_states": "in, sensor_msgs/JointState: pose of the body",
    "gravity": "in, geometry_msgs/Vector3Stamped: direction of gravity in the body's root frame, any length but zero; "
    "joint states are draped with the latest, so send it before them",
    "~/garment": "out, sensor_msgs/PointCloud2: points [m] and normals, body's root frame, stamp of the joint state",
    "/diagnostics": "out, diagnostic_msgs/DiagnosticArray at 1 Hz",
    "~/description": "out, physkin_msgs/GarmentDescription: faces and names, latched; with physkin_msgs installed",
    "~/nodes": "out, physkin_msgs/GarmentNodes: garment node transforms; with physkin_msgs installed",
}
"""Name -> direction, type and meaning, for the usage text."""
WARNING_PERIOD = 1.0  # [s] rejected messages are warned about at most this often


class DrapeNode(Node):
    """Drapes one garment on one body, a joint state at a time.

    Raises ValueError (model, avatar, rig, joint map, parameter values) or ParameterException (parameter types).
    """

    def __init__(self, **arguments) -> None:
        """arguments: as `rclpy.node.Node` takes them, such as `context` and `parameter_overrides`."""
        super().__init__("drape_node", **arguments)
        self._declare_parameters()
        model = load_garment_model(self._text("model"))
        rig_file = self._text("body_rig") or None
        avatar = load_avatar(self._text("body_mesh") or BUNDLED_AVATAR, model.rig, rig_file=rig_file)
        for warning in avatar.warnings:
            self.get_logger().warning(warning)
        map_file = self._text("joint_map")
        self._translate = None
        if map_file == ROS4HRI:
            self._translate, map_file = Ros4hriReader(model.rig).translate, ""
        self._reader = JointStateReader(
            model.rig.joint_names,
            model.rig.rest,
            joint_map=load_joint_map(map_file, model.rig.joint_names) if map_file else None,
            on_unknown=self._warn_unknown,
        )
        self._draper = Draper(
            model,
            avatar,
            backend=self._text("backend"),
            precision=self._text("precision"),
            fit=self.get_parameter("fit").value,
            push_out=self.get_parameter("push_out").value,
        )
        self._gravity = np.array(self.get_parameter("gravity").value, dtype=np.float64)
        self.add_on_set_parameters_callback(self._on_parameters)
        self._statistics = DrapeStatistics()
        self._cloud = GarmentCloud(self._draper.vertex_count, self._text("frame_id"))
        self._open_topics()

    def _declare_parameters(self) -> None:
        for name, (default, description) in PARAMETERS.items():
            descriptor = ParameterDescriptor(description=description, read_only=name != "gravity")
            descriptor.dynamic_typing = name == "gravity"  # [0, 0, -1] on a command line are integers
            self.declare_parameter(name, default, descriptor)
        choices = {"executor": EXECUTORS, "backend": physkin_core.BACKENDS}
        for name, allowed in choices.items():
            if self._text(name) not in allowed:
                raise ValueError(f"parameter {name} is {self._text(name)!r}; allowed: {', '.join(allowed)}")
        for name in ("model", "frame_id", "precision"):
            if not self._text(name):
                raise ValueError(f"parameter {name} must not be empty")
        try:
            gravity_direction(self.get_parameter("gravity").value)
        except ValueError as error:
            raise ValueError(f"parameter {error}") from None
        unknown = [name for name in self._parameter_overrides if not self.has_parameter(name)]
        if unknown := sorted(name for name in unknown if not name.startswith("qos_overrides.")):
            self.get_logger().warning(f"no such parameter: {', '.join(unknown)}; there are {', '.join(PARAMETERS)}")

    def _open_topics(self) -> None:
        quality = {
            "qos_profile": QoSProfile(depth=5),
            "qos_overriding_options": QoSOverridingOptions.with_default_policies(),
        }
        self._publisher = self.create_publisher(PointCloud2, "~/garment", **quality)
        self._nodes_publisher = None
        if GarmentDescription is not None:
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._description_publisher = self.create_publisher(GarmentDescription, "~/description", latched)
            description = garment_description(self._draper, self._text("frame_id"))
            description.header.stamp = self.get_clock().now().to_msg()
            self._description_publisher.publish(description)
            self._nodes_publisher = self.create_publisher(GarmentNodes, "~/nodes", **quality)
            self._nodes = GarmentNodes()
            self._nodes.header.frame_id = self._text("frame_id")
        self._diagnostics_publisher = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics)
        # first: when both have messages waiting, executors serve the older subscription before the younger
        self.create_subscription(Vector3Stamped, "gravity", self._on_gravity, **quality)
        subscription = self.create_subscription(JointState, "joint_states", self._on_joint_state, **quality)
        self.get_logger().info(
            f"{self._draper.model.name} with {self._draper.vertex_count} vertices: "
            f"{subscription.topic_name} -> {self._publisher.topic_name}"
        )

    def _on_joint_state(self, message: JointState) -> None:
        self._statistics.received += 1
        try:
            names, values = message.name, message.position
            if self._translate is not None:
                names, values = self._translate(names, values)
            positions = self._reader.read(names, values)
            started = perf_counter_ns()
            self._draper.drape(positions, self._gravity, out=self._cloud.points)
            evaluation_ns = perf_counter_ns() - started
        except ValueError as error:
            self._statistics.reject(str(error))
            self.get_logger().warning(f"joint state ignored: {error}", throttle_duration_sec=WARNING_PERIOD)
            return
        self._reader.positions = positions
        stamp = message.header.stamp
        self._cloud.message.header.stamp = stamp
        self._publisher.publish(self._cloud.message)
        self._statistics.draped(stamp.sec * 1_000_000_000 + stamp.nanosec, evaluation_ns)
        if self._nodes_publisher is not None and self._nodes_publisher.get_subscription_count():
            self._nodes.header.stamp = stamp
            self._nodes.transforms = self._draper.node_transforms().ravel()
            self._nodes_publisher.publish(self._nodes)

    def _on_gravity(self, message: Vector3Stamped) -> None:
        try:
            self._gravity = gravity_direction([message.vector.x, message.vector.y, message.vector.z])
        except ValueError as error:
            self._statistics.reject_gravity(str(error))
            self.get_logger().warning(f"gravity message ignored: {error}", throttle_duration_sec=WARNING_PERIOD)

    def _publish_diagnostics(self) -> None:
        now = self.get_clock().now()
        well, summary, values = self._statistics.report(now.nanoseconds)
        model = self._draper.model.name
        values |= {"model": model, "backend": self._draper.backend, "instruction set": self._draper.instruction_set}
        values["precision"] = self._text("precision")
        if (residual := self._draper.residual) is not None:
            values |= contact_values(residual)
        values["gravity"] = " ".join(f"{value:.3f}" for value in self._gravity)
        status = diagnostic_status(f"{self.get_name()}: {model}", self._draper.avatar.source, well, summary, values)
        report = DiagnosticArray(status=[status])
        report.header.stamp = now.to_msg()
        self._diagnostics_publisher.publish(report)

    def _on_parameters(self, parameters) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "gravity":
                try:
                    self._gravity = gravity_direction(parameter.value)
                except ValueError as error:
                    return SetParametersResult(successful=False, reason=f"parameter {error}")
        return SetParametersResult(successful=True)

    def _warn_unknown(self, names: list[str]) -> None:
        self.get_logger().warning(f"joints without a counterpart in the rig are ignored: {', '.join(names)}")

    def _text(self, parameter: str) -> str:
        return self.get_parameter(parameter).value


def spin(node: DrapeNode) -> None:
    """Serve the node until its context is shut down."""
    executor = EXECUTORS[node.get_parameter("executor").value]()
    executor.add_node(node)
    try:
        while rclpy.ok():  # EventsExecutor delivers nothing in spin(), nor in spin_once() without a timeout
            executor.spin_once(timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:  # rclpy's, when a signal ends the context between ok() and the wait
        if rclpy.ok():
            raise
    finally:
        executor.remove_node(node)
        executor.shutdown()


def main(argv: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM. argv: without the program's name. Returns the exit status."""
    arguments = ["drape_node", *(sys.argv[1:] if argv is None else argv)]
    use_shipped_profile()
    node = None
    try:
        _initialise(arguments)
        if unknown := remove_ros_args(arguments)[1:]:
            return _explain_usage(unknown)
        _forward_log()
        node = DrapeNode()
        spin(node)
        return 0
    except KeyboardInterrupt:
        return 0
    except (ValueError, OSError, ImportError, ParameterException, NameValidationException) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def _initialise(arguments: list[str]) -> None:
    """`rclpy.init`; raises ValueError on malformed ROS arguments."""
    try:
        rclpy.init(args=arguments)
    except RuntimeError as error:
        raise ValueError(str(error)) from error


def _explain_usage(arguments: list[str]) -> int:
    """Text of --help; the same after arguments that mean nothing."""
    lines = ["usage: physkin node [--ros-args -p PARAMETER:=VALUE ... -r TOPIC:=TOPIC ...]", "", "parameters:"]
    lines += [f"  {name:<10} {text} (default {default!r})" for name, (default, text) in PARAMETERS.items()]
    lines += ["", "topics:", *(f"  {name:<13} {text}" for name, text in TOPICS.items())]
    lines += ["", "Ended by SIGKILL the node leaves shared memory (/dev/shm/fastrtps_*) behind: fastdds shm clean."]
    wanted = bool({"-h", "--help"} & set(arguments))
    print("\n".join(lines), file=sys.stdout if wanted else sys.stderr)
    if not wanted:
        print(f"error: unknown arguments: {' '.join(arguments)}", file=sys.stderr)
    return 0 if wanted else 2


def _forward_log() -> None:
    """Send what the core logs, such as the time a body's encoding took, to the ROS log."""
    logger = logging.getLogger("physkin_core")
    logger.setLevel(logging.INFO)
    logger.addHandler(_RosLogHandler())


class _RosLogHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        # one line a level: rclpy ties each call site to the level of its first message
        if record.levelno >= logging.ERROR:
            get_logger(record.name).error(record.getMessage())
        elif record.levelno >= logging.WARNING:
            get_logger(record.name).warning(record.getMessage())
        else:
            get_logger(record.name).info(record.getMessage())
