"""A garment of an avatar: its topics, and the messages that its frames fill."""

from __future__ import annotations

from dataclasses import fields
from time import perf_counter_ns

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from physkin_core import Layer, Outfit
from physkin_core.model.skinning import SkinningData
from physkin_core.points.splat_draper import SplatSkinner
from physkin_core.points.splats_on_outfit import SplatsOnOutfit
from physkin_ros.messages.conversions import GarmentCloud, NodesMessage, TriangleMarker, body_covered, garment_mesh
from physkin_ros.messages.interfaces import missing_interfaces
from physkin_ros.messages.splat_cloud import SplatCloud, splat_attributes
from physkin_ros.messages.topics import GARMENT, GARMENT_NODES, MARKER, MESH, SPLAT_ATTRIBUTES, SPLATS
from physkin_ros.middleware.quality_of_service import stream_quality
from physkin_ros.node.settings import AvatarSettings, GarmentSettings

__all__ = ["GarmentStream", "LayerMessages"]


class GarmentStream:
    """Topics of one garment. They stay when body or garment are swapped."""

    def __init__(self, node, avatar: AvatarSettings, settings: GarmentSettings) -> None:
        self.settings, self.avatar_id, self.frame_id = settings, avatar.id, avatar.frame_id
        self.name = f"{avatar.id}/{settings.name}" if avatar.id else ""
        self._node = node
        self._look_shown = False
        place = "/".join(filter(None, ("~", avatar.id, settings.name)))
        latched = {"qos_profile": QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)}
        kinds = {GARMENT: (PointCloud2, stream_quality()), MARKER: (Marker, stream_quality())}
        if settings.splats:
            kinds |= {SPLATS: (PointCloud2, stream_quality()), SPLAT_ATTRIBUTES: (PointCloud2, latched)}
        if not missing_interfaces():
            from physkin_msgs.msg import GarmentMesh, GarmentNodes

            kinds |= {GARMENT_NODES: (GarmentNodes, stream_quality()), MESH: (GarmentMesh, latched)}
        self._publishers = {
            topic: node.create_publisher(kind, topic.below(place), **quality)
            for topic, (kind, quality) in kinds.items()
        }
        self.cloud_publisher, self.marker_publisher, self.splat_publisher, self.nodes_publisher = map(
            self._publishers.get, (GARMENT, MARKER, SPLATS, GARMENT_NODES)
        )

    def show_look(self, look: np.ndarray | None) -> None:
        """Publish, once, what is known of the splats besides how they move: (n,) records, or None."""
        if look is not None and not self._look_shown:
            message = splat_attributes(look, self.frame_id)
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._publishers[SPLAT_ATTRIBUTES].publish(message)
            self._look_shown = True

    def show_mesh(self, outfit: Outfit, index: int, revision: int) -> None:
        """Publish what changes with the garment only. index: of the garment in its outfit."""
        if MESH in self._publishers:
            message = garment_mesh(outfit, index, self.frame_id, revision=revision, avatar=self.avatar_id)
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._publishers[MESH].publish(message)

    def close(self) -> None:
        """Take the topics down."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)


class LayerMessages:
    """A garment of an outfit, and the messages that its frames fill.

    index: of the garment in its outfit. before: what was worn on the same topics until now. points: (n, 6) float32 of
    the cloud, to be draped into. revision: of the garment's mesh, which a swap of the body alone does not change in one
    size.
    """

    def __init__(
        self,
        stream: GarmentStream,
        outfit: Outfit,
        index: int,
        *,
        splats: SplatsOnOutfit | None = None,
        before: LayerMessages | None = None,
    ) -> None:
        self.stream, self.outfit, self.index = stream, outfit, index
        self.revision = 1 if before is None else before.revision + (not self._has_mesh_of(before))
        self._cloud = GarmentCloud(self.layer.vertex_count, stream.frame_id)
        self.points = self._cloud.points
        self._has_faces, self._marker = len(self.layer.faces) > 0, None
        self._nodes = self._splats = None
        if stream.nodes_publisher is not None:
            self._nodes = NodesMessage(self.layer.bound_visible, stream.frame_id, self.revision)
        if splats is not None:
            self._splats = SplatMessages(SplatSkinner(splats.bound), stream.frame_id)
            stream.show_look(splats.look)

    @property
    def layer(self) -> Layer:
        """The garment as it is worn."""
        return self.outfit.layers[self.index]

    def show_mesh(self) -> None:
        """Publish the garment's mesh."""
        self.stream.show_mesh(self.outfit, self.index, self.revision)

    def publish(self, sec: int, nanosec: int) -> None:
        """Publish the frame with the joint state's stamp; all but the cloud only to those who listen."""
        stream = self.stream
        self._cloud.publish(stream.cloud_publisher, sec, nanosec)
        if self._nodes is not None and stream.nodes_publisher.handle.get_subscription_count():
            self._nodes.transforms[:] = self.outfit.node_transforms()[self.index]
            self._nodes.detail_offsets[:] = self.outfit.detail_offsets()[self.index]
            self._nodes.publish(stream.nodes_publisher, sec, nanosec)
        if self._has_faces and stream.marker_publisher.handle.get_subscription_count():
            if self._marker is None:
                self._marker = TriangleMarker(self.layer.faces, stream.frame_id, stream.name)
            self._marker.publish(stream.marker_publisher, self.points, sec, nanosec)
        if self._splats is not None and stream.splat_publisher.get_subscription_count():
            moved = self.outfit.node_transforms()[self.index], self.outfit.detail_offsets()[self.index]
            self._splats.publish(stream.splat_publisher, *moved, sec, nanosec)

    def _has_mesh_of(self, other: LayerMessages) -> bool:
        """Whether the mesh is the same in messages, as of the same garment on another body, in one size. Made to
        measure, another body means another rest shape; in an outfit it may mean other hidden vertices."""
        mine, others = self._mesh_parts(), other._mesh_parts()
        return mine[0] == others[0] and all(map(np.array_equal, mine[1], others[1]))

    def _mesh_parts(self) -> tuple[tuple, list[np.ndarray]]:
        """What the message of the mesh is made of."""
        layer = self.layer
        skinned = [getattr(layer.bound_visible, field.name) for field in fields(SkinningData)]
        arrays = [*skinned, layer.faces, layer.visible, body_covered(self.outfit, self.index)]
        return (layer.name, self.index, len(self.outfit.layers), layer.moved), arrays


class SplatMessages:
    """The splats of a garment, where its garment nodes take them. They take half of the time at most: clouds go
    first."""

    def __init__(self, skinner: SplatSkinner, frame_id: str) -> None:
        self._skinner = skinner
        self._cloud = SplatCloud(skinner.splat_count, frame_id)
        self._free_ns = 0

    def publish(
        self, publisher, node_transforms: np.ndarray, detail_offsets: np.ndarray, sec: int, nanosec: int
    ) -> None:
        """Publish the splats of a frame with garment nodes (m, 3, 4) and detail nodes off their rest (D, 3), unless the
        last ones took so long that it is too soon."""
        began = perf_counter_ns()
        if began < self._free_ns:
            return
        self._cloud.fill(self._skinner.skin(node_transforms, detail_offsets))
        self._cloud.publish(publisher, sec, nanosec)
        now = perf_counter_ns()
        self._free_ns = 2 * now - began
