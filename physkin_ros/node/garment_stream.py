"""One garment of an avatar: its topics, and the evaluator that is worn at the moment."""

from __future__ import annotations

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions, QoSPolicyKind
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from physkin_core import Draper
from physkin_core.runtime.rest_look import RestLook
from physkin_ros.messages.conversions import GarmentCloud, NodesMessage, TriangleMarker, garment_mesh
from physkin_ros.messages.interfaces import missing_interfaces
from physkin_ros.node.diagnostics import GarmentStatistics
from physkin_ros.node.settings import AvatarSettings, GarmentSettings

__all__ = ["GarmentStream", "WornGarment", "stream_quality"]


def stream_quality(depth: int = 5, *, reliable: bool = True) -> dict[str, object]:
    """Arguments of a stream's publisher or subscription: keep last, open to `qos_overrides` parameters.

    reliable: else best effort, as sensor drivers publish; a subscription takes reliable publishers', too.
    """
    policies = ("HISTORY", "DEPTH", "RELIABILITY", "DURABILITY", "DEADLINE", "LIVELINESS", "LIVELINESS_LEASE_DURATION")
    overrides = QoSOverridingOptions(policy_kinds=[QoSPolicyKind[policy] for policy in policies])
    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return {"qos_profile": QoSProfile(depth=depth, reliability=reliability), "qos_overriding_options": overrides}


class GarmentStream:
    """Topics and counts of one garment. They stay when body or garment are swapped.

    topics: what its topics are below, such as "~" or "~/alice/top".
    """

    def __init__(self, node, avatar: AvatarSettings, settings: GarmentSettings, topics: str) -> None:
        self.settings = settings
        self.name = f"{avatar.id}/{settings.name}" if avatar.id else ""
        self.frame_id = avatar.frame_id
        self.avatar_id = avatar.id
        self.statistics = GarmentStatistics()
        self._node = node
        self.cloud_publisher = node.create_publisher(PointCloud2, f"{topics}/garment", **stream_quality())
        self.marker_publisher = None
        if settings.marker:
            self.marker_publisher = node.create_publisher(Marker, f"{topics}/marker", **stream_quality())
        self.nodes_publisher = self._mesh_publisher = None
        if not missing_interfaces():
            from physkin_msgs.msg import GarmentMesh, GarmentNodes

            self.nodes_publisher = node.create_publisher(GarmentNodes, f"{topics}/garment_nodes", **stream_quality())
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._mesh_publisher = node.create_publisher(GarmentMesh, f"{topics}/mesh", latched)

    def show_mesh(self, draper: Draper, revision: int) -> None:
        """Publish what changes with the garment only."""
        if self._mesh_publisher is not None:
            message = garment_mesh(draper, self.frame_id, revision=revision, avatar=self.avatar_id)
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._mesh_publisher.publish(message)

    def close(self) -> None:
        """Take the topics down."""
        for publisher in (self.cloud_publisher, self.marker_publisher, self.nodes_publisher, self._mesh_publisher):
            if publisher is not None:
                self._node.destroy_publisher(publisher)


class WornGarment:
    """A draper and the messages it fills, bound to the pose (d,) and gravity (3,) arrays of its avatar.

    at_rest: how it sits. gravity: effective gravity in units of gravity for a model that has learnt it, else the unit
    direction. revision: of the garment's mesh, which a swap of the body alone does not change in one size.
    step: drapes what those arrays hold now; raises ValueError when the result is not finite.
    """

    def __init__(
        self,
        stream: GarmentStream,
        draper: Draper,
        at_rest: RestLook,
        revision: int,
        pose: np.ndarray,
        gravity: np.ndarray,
    ) -> None:
        self.stream, self.draper, self.at_rest = stream, draper, at_rest
        self.revision = revision
        self._cloud = GarmentCloud(self.draper.vertex_count, stream.frame_id)
        self.step = self.draper.bind_step(pose, gravity, self._cloud.points)
        self._nodes = self._marker = None
        if stream.nodes_publisher is not None:
            self._nodes = NodesMessage(len(self.draper.bound.node_rest), stream.frame_id, self.revision)
        if stream.marker_publisher is not None and len(self.draper.faces):
            self._marker = TriangleMarker(self.draper.faces, stream.frame_id, stream.name)

    def publish(self, sec: int, nanosec: int) -> None:
        """Publish the frame with the joint state's stamp; garment nodes and marker only to those who listen."""
        stream = self.stream
        self._cloud.publish(stream.cloud_publisher, sec, nanosec)
        if self._nodes is not None and stream.nodes_publisher.handle.get_subscription_count():
            self._nodes.transforms[:] = self.draper.node_transforms()
            self._nodes.publish(stream.nodes_publisher, sec, nanosec)
        if self._marker is not None and stream.marker_publisher.get_subscription_count():
            self._marker.publish(stream.marker_publisher, self._cloud.points, sec, nanosec)
