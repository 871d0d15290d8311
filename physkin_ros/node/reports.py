"""What the drape node tells once a second: `/diagnostics`, and `~/statistics` where `physkin_msgs` is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic_ns

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from physkin_ros.messages.interfaces import missing_interfaces
from physkin_ros.messages.topics import DIAGNOSTICS, STATISTICS
from physkin_ros.node.avatar_stream import AvatarStream
from physkin_ros.node.diagnostics import Health, diagnostic_status
from physkin_ros.node.garment_stream import GarmentStream, LayerMessages
from physkin_ros.root.gravity import EffectiveGravity

__all__ = ["PERIOD", "Reports"]

PERIOD = 1.0  # [s]


class Reports:
    """Publishes until closed. streams: gives the avatars that there are."""

    def __init__(self, node: Node, streams: Callable[[], Iterable[AvatarStream]]) -> None:
        self._node, self._streams = node, streams
        self._diagnostics = node.create_publisher(DiagnosticArray, DIAGNOSTICS.name, 10)
        self._statistics = None
        if not missing_interfaces():
            from physkin_msgs.msg import DrapeStatistics

            self._statistics = node.create_publisher(DrapeStatistics, STATISTICS.name, 10)
        self._shared: set[str] = set()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand
        self._timer = node.create_timer(PERIOD, self._report, clock=steady)

    def close(self) -> None:
        """Take timer and topics down."""
        self._node.destroy_timer(self._timer)
        for publisher in (self._diagnostics, self._statistics):
            if publisher is not None:
                self._node.destroy_publisher(publisher)

    def _report(self) -> None:
        now, monotonic = self._node.get_clock().now(), monotonic_ns()
        report = DiagnosticArray()
        report.header.stamp = now.to_msg()
        figures = []
        for stream in self._streams():
            health, worn = stream.health(monotonic), stream.worn
            shown = _values_of(stream, health, now.nanoseconds)
            for index, garment in enumerate(stream.garments):
                layer = None if worn is None else worn.garments[index]
                figures.append((garment, layer, health))
                report.status.append(self._status(stream, garment, layer, health, shown))
        self._diagnostics.publish(report)
        if self._statistics is not None:
            from physkin_msgs.msg import DrapeStatistics, GarmentStatistics

            message = DrapeStatistics(header=report.header)
            for garment, layer, health in figures:
                names = {"avatar": garment.avatar_id, "garment": garment.settings.name}
                message.garments.append(GarmentStatistics(**names, model_name=_model_of(garment, layer)))
                health.fill(message.garments[-1])
                message.period = health.period
            self._statistics.publish(message)

    def _status(
        self,
        stream: AvatarStream,
        garment: GarmentStream,
        worn: LayerMessages | None,
        health: Health,
        values: dict[str, str],
    ) -> DiagnosticStatus:
        model, source, (well, summary) = _model_of(garment, worn), "", health.summary()
        values = values | {"model": model}
        if worn is None:
            error = health.reasons.get("swaps_failed")
            well, summary = False, f"nothing to drape: {error}" if error else "the garment is being loaded"
        else:
            outfit, layer, whole = worn.outfit, worn.layer, len(worn.layer.hidden)
            source = outfit.avatar.source
            values |= {
                "instruction set": outfit.instruction_set,
                "precision": outfit.precision,
                "fit": f"{layer.fit:g}",
                "advice": layer.at_rest.advice or "none",
                "cloth inside the body at rest [%]": f"{layer.at_rest.inside_percent:.1f}",
                "layer": f"{worn.index + 1} of {len(outfit.layers)} from the skin outwards",
                "vertices left out": f"{whole - layer.vertex_count} of {whole}",
            }
            if not stream.active:
                summary = "inactive"
        topic = garment.cloud_publisher.topic_name
        if self._is_shared(topic):
            well, summary = False, f"somebody else publishes on {topic}, too; {summary}"
        return diagnostic_status(f"{self._node.get_name()}: {garment.name or model}", source, well, summary, values)

    def _is_shared(self, topic: str) -> bool:
        """Whether readers of a topic of clouds get somebody else's among ours; warns when that begins."""
        shared = self._node.count_publishers(topic) > 1
        if shared and topic not in self._shared:
            self._node.get_logger().warning(
                f"somebody else publishes on {topic}, too: readers get both, mixed. Is a node of this name running "
                "already? End it, or rename this one: --ros-args -r __node:=OTHER_NAME"
            )
        self._shared = self._shared | {topic} if shared else self._shared - {topic}
        return shared


def _model_of(garment: GarmentStream, worn: LayerMessages | None) -> str:
    return garment.settings.model if worn is None else worn.layer.name


def _values_of(stream: AvatarStream, health: Health, now_ns: int) -> dict[str, str]:
    """What diagnostics say of an avatar, whatever the garment. now_ns: time on the stamps' clock."""
    motion = stream.root.motion()
    felt = _numbers(motion.vector, 2) if isinstance(motion, EffectiveGravity) else "none"
    return health.values(now_ns) | {
        "gravity": _numbers(stream.root.direction(0), 3),
        "effective gravity [m/s2]": felt,
        "wind [m/s]": _numbers(stream.root.frame_input.wind, 2),
    }


def _numbers(values: Iterable[float], decimals: int) -> str:
    return " ".join(f"{value:.{decimals}f}" for value in values)
