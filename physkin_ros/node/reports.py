"""What the drape node tells once a second: `/diagnostics`, and `~/statistics` where `physkin_msgs` is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic_ns

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from physkin_ros.messages.interfaces import missing_interfaces
from physkin_ros.messages.topics import DIAGNOSTICS, STATISTICS
from physkin_ros.node.avatar_stream import AvatarStream
from physkin_ros.node.diagnostics import diagnostic_status

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
        health = [(stream, *each) for stream in self._streams() for each in stream.health(monotonic)]
        report = DiagnosticArray()
        report.header.stamp = now.to_msg()
        report.status = [self._status(*each, now.nanoseconds) for each in health]
        self._diagnostics.publish(report)
        if self._statistics is not None:
            from physkin_msgs.msg import DrapeStatistics, GarmentStatistics

            numbers = DrapeStatistics(header=report.header)
            for _, worn, garment, found in health:
                model = garment.settings.model if worn is None else worn.layer.name
                entry = GarmentStatistics(avatar=garment.avatar_id, garment=garment.settings.name, model_name=model)
                found.fill(entry)
                numbers.period = found.period
                numbers.garments.append(entry)
            self._statistics.publish(numbers)

    def _status(self, stream: AvatarStream, worn, garment, found, now_ns: int):
        values = found.values(now_ns)
        well, summary = found.summary()
        topic = garment.cloud_publisher.topic_name
        if self._is_shared(topic):
            well, summary = False, f"somebody else publishes on {topic}, too; {summary}"
        model, source = garment.settings.model, ""
        if worn is not None:
            outfit, layer = worn.outfit, worn.layer
            model, source, whole = layer.name, outfit.avatar.source, len(layer.hidden)
            values |= {"instruction set": outfit.instruction_set, "precision": outfit.precision}
            values |= {"fit": f"{layer.fit:g}", "advice": layer.at_rest.advice or "none"}
            values["cloth inside the body at rest [%]"] = f"{layer.at_rest.inside_percent:.1f}"
            values["layer"] = f"{worn.index + 1} of {len(outfit.layers)} from the skin outwards"
            values["vertices left out"] = f"{whole - layer.vertex_count} of {whole}"
        values["model"] = model
        felt = stream.root.effective_gravity(stream.garments.index(garment), monotonic_ns())
        values["gravity"] = " ".join(f"{value:.3f}" for value in stream.root.direction(0))
        values["effective gravity [m/s2]"] = "none" if felt is None else " ".join(f"{value:.2f}" for value in felt)
        values["wind [m/s]"] = " ".join(f"{value:.2f}" for value in stream.root.frame_input.wind)
        if worn is None:
            error = stream.statistics.last_error
            well, summary = False, f"nothing to drape: {error}" if error else "the garment is being loaded"
        elif not stream.active:
            summary = "inactive"
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
