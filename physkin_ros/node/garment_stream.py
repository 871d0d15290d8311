"""A garment of an avatar, its topics, and what is worn at the moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import groupby
from time import perf_counter_ns

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from physkin_core import Layer, LimbSeparator, Outfit
from physkin_core.model.skinning import SkinningData
from physkin_core.points.splat_draper import SplatSkinner
from physkin_core.rig.rig import Rig
from physkin_ros.joints.bone_rotation_message import BoneRotationReader
from physkin_ros.joints.joint_state_wire import JointStateWire
from physkin_ros.joints.joint_states import JointStateReader
from physkin_ros.messages.conversions import GarmentCloud, NodesMessage, TriangleMarker, body_covered, garment_mesh
from physkin_ros.messages.interfaces import missing_interfaces
from physkin_ros.messages.splat_cloud import SplatCloud, splat_attributes
from physkin_ros.messages.topics import GARMENT, GARMENT_NODES, MARKER, MESH, SPLAT_ATTRIBUTES, SPLATS
from physkin_ros.middleware.quality_of_service import stream_quality
from physkin_ros.node.asset_loading import LoadedLayer
from physkin_ros.node.diagnostics import GarmentStatistics, PoseRange
from physkin_ros.node.interpolation import PoseInterpolator
from physkin_ros.node.settings import AvatarSettings, GarmentSettings

__all__ = [
    "GarmentStream",
    "LayerMessages",
    "Pass",
    "WornOutfits",
    "passes_of",
    "same_mesh",
]


class GarmentStream:
    """Topics and counts of one garment. They stay when body or garment are swapped.

    place: what its topics are below, such as "~" or "~/alice/top".
    """

    def __init__(self, node, avatar: AvatarSettings, settings: GarmentSettings, place: str) -> None:
        self.settings = settings
        self.name = f"{avatar.id}/{settings.name}" if avatar.id else ""
        self.frame_id = avatar.frame_id
        self.avatar_id = avatar.id
        self.statistics = GarmentStatistics()
        self._node = node
        self.cloud_publisher = node.create_publisher(PointCloud2, GARMENT.below(place), **stream_quality())
        self.marker_publisher = None
        if settings.publish_marker:
            self.marker_publisher = node.create_publisher(Marker, MARKER.below(place), **stream_quality())
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.splat_publisher = self._look_publisher = None
        self._look_shown = False
        if settings.splats:
            self.splat_publisher = node.create_publisher(PointCloud2, SPLATS.below(place), **stream_quality())
            self._look_publisher = node.create_publisher(PointCloud2, SPLAT_ATTRIBUTES.below(place), latched)
        self.nodes_publisher = self._mesh_publisher = None
        if not missing_interfaces():
            from physkin_msgs.msg import GarmentMesh, GarmentNodes

            self.nodes_publisher = node.create_publisher(GarmentNodes, GARMENT_NODES.below(place), **stream_quality())
            self._mesh_publisher = node.create_publisher(GarmentMesh, MESH.below(place), latched)

    def show_look(self, look: np.ndarray | None) -> None:
        """Publish, once, what is known of the splats besides how they move: (n,) records, or None."""
        if look is not None and not self._look_shown:
            message = splat_attributes(look, self.frame_id)
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._look_publisher.publish(message)
            self._look_shown = True

    def show_mesh(self, outfit: Outfit, index: int, revision: int) -> None:
        """Publish what changes with the garment only. index: of the garment in its outfit."""
        if self._mesh_publisher is not None:
            message = garment_mesh(outfit, index, self.frame_id, revision=revision, avatar=self.avatar_id)
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._mesh_publisher.publish(message)

    def close(self) -> None:
        """Take the topics down."""
        for publisher in (
            *(self.cloud_publisher, self.marker_publisher, self.nodes_publisher, self._mesh_publisher),
            *(self.splat_publisher, self._look_publisher),
        ):
            if publisher is not None:
                self._node.destroy_publisher(publisher)


class LayerMessages:
    """A garment of an outfit, and the messages that its frames fill.

    index: of the garment in its outfit. revision: of the garment's mesh, which a swap of the body alone does not change
    in one size. points: (n, 6) float32 of the cloud, to be draped into.
    """

    def __init__(self, stream: GarmentStream, loaded: LoadedLayer, revision: int) -> None:
        self.stream, self.outfit, self.index, self.revision = stream, loaded.outfit, loaded.index, revision
        self._cloud = GarmentCloud(self.layer.vertex_count, stream.frame_id)
        self.points = self._cloud.points
        self._nodes = self._marker = None
        if stream.nodes_publisher is not None:
            self._nodes = NodesMessage(self.layer.bound_visible, stream.frame_id, self.revision)
        if stream.marker_publisher is not None and len(self.layer.faces):
            self._marker = TriangleMarker(self.layer.faces, stream.frame_id, stream.name)
        self._splats = None
        if loaded.splats is not None:
            skinner = SplatSkinner(loaded.splats.bound, precision=self.outfit.precision)
            self._splats = SplatMessages(skinner, stream.frame_id)
            stream.show_look(loaded.splats.look)

    @property
    def layer(self) -> Layer:
        """The garment as it is worn."""
        return self.outfit.layers[self.index]

    def publish(self, sec: int, nanosec: int) -> None:
        """Publish the frame with the joint state's stamp; all but the cloud only to those who listen."""
        stream = self.stream
        self._cloud.publish(stream.cloud_publisher, sec, nanosec)
        if self._nodes is not None and stream.nodes_publisher.handle.get_subscription_count():
            self._nodes.transforms[:] = self.outfit.node_transforms()[self.index]
            self._nodes.features[:] = self.outfit.features()[self.index]
            self._nodes.publish(stream.nodes_publisher, sec, nanosec)
        if self._marker is not None and stream.marker_publisher.get_subscription_count():
            self._marker.publish(stream.marker_publisher, self.points, sec, nanosec)
        if self._splats is not None and stream.splat_publisher.get_subscription_count():
            moved = self.outfit.node_transforms()[self.index], self.outfit.features()[self.index]
            self._splats.publish(stream.splat_publisher, *moved, sec, nanosec)


class SplatMessages:
    """The splats of a garment, where its garment nodes take them. They take half of the time at most: clouds go
    first."""

    def __init__(self, skinner: SplatSkinner, frame_id: str) -> None:
        self._skinner = skinner
        self._cloud = SplatCloud(skinner.splat_count, frame_id)
        self._free_ns = 0

    def publish(self, publisher, node_transforms: np.ndarray, features: np.ndarray, sec: int, nanosec: int) -> None:
        """Publish the splats of a frame with garment nodes (m, 3, 4) and features (F,), unless the last ones took so
        long that it is too soon."""
        began = perf_counter_ns()
        if began < self._free_ns:
            return
        self._cloud.fill(self._skinner.skin(node_transforms, features))
        self._cloud.publish(publisher, sec, nanosec)
        now = perf_counter_ns()
        self._free_ns = 2 * now - began


@dataclass(frozen=True)
class Pass:
    """Garments that are draped together, those of one outfit. step: drapes them all; raises ValueError when a result is
    not finite."""

    step: Callable[[], None]
    garments: tuple[LayerMessages, ...]


def passes_of(garments: Sequence[LayerMessages], pose: np.ndarray, inputs: np.ndarray) -> tuple[Pass, ...]:
    """What drapes the garments of an avatar, outfit by outfit, from what these arrays hold then.

    pose: (d,) [rad]. inputs: (garments, 13) as of `FrameInput.rows`.
    """
    passes = []
    for _, worn in groupby(enumerate(garments), key=lambda each: id(each[1].outfit)):
        rows, together = zip(*worn)
        outs = [each.points for each in together]
        step = together[0].outfit.bind_frame(pose, inputs[rows[0] : rows[-1] + 1], outs)
        passes.append(Pass(step, together))
    return tuple(passes)


def same_mesh(before: LayerMessages, now: LoadedLayer) -> bool:
    """Whether two garments have the same mesh in their messages: of the same garment on another body, in one size.
    Made to measure, another body means another rest shape; in an outfit it may mean other hidden vertices."""
    pairs = [(each.layer.name, each.index, len(each.outfit.layers), each.layer.moved) for each in (before, now)]
    arrays = [_mesh_arrays(each) for each in (before, now)]
    return pairs[0] == pairs[1] and all(map(np.array_equal, *arrays))


def _mesh_arrays(worn: LayerMessages | LoadedLayer) -> list[np.ndarray]:
    """What the message of its mesh is made of."""
    skinned = [getattr(worn.layer.bound_visible, field.name) for field in fields(SkinningData)]
    return [*skinned, worn.layer.faces, worn.layer.visible, body_covered(worn.outfit, worn.index)]


class WornOutfits:
    """What an avatar wears, bound to its pose, and the reader of joint states for its rig.

    pose: (d,) float32 [rad], what comes in. draped: (d,) what is draped: the same array, or another one that
    `separator` fills. garments: in the order of the avatar's streams; passes: what drapes them. bones: further
    arguments of `BoneRotationReader`.
    """

    def __init__(
        self,
        reader: JointStateReader,
        rig: Rig,
        garment_count: int,
        interpolates: bool,
        separator: LimbSeparator | None,
        **bones,
    ) -> None:
        self.reader = reader
        self._rig, self._bones = rig, bones
        self.pose = reader.positions.copy()
        self.wire = JointStateWire(reader, self.pose)
        self.separator = separator
        self.draped = self.pose if separator is None else self.pose.copy()
        self.range = PoseRange(rig, self.pose)
        self.interpolator = PoseInterpolator(len(self.pose), garment_count) if interpolates else None
        self.garments: tuple[LayerMessages, ...] = ()
        self.passes: tuple[Pass, ...] = ()

    @cached_property
    def bone_rotations(self) -> BoneRotationReader:
        """Reads rotations of bones. Raises JointStateError for a rig that these are not for."""
        return BoneRotationReader(self._rig, self.reader, **self._bones)
