"""Between ROS messages and the core's arrays: gravity in; clouds, meshes and garment nodes out.

Dimensions: `n` garment vertices, `m` garment nodes, `D` detail nodes. Metres, root frame.
"""

from __future__ import annotations

import sys
from array import array
from typing import TYPE_CHECKING

import numpy as np

from physkin_core import Outfit
from physkin_core.model.skinning import SkinningData
from physkin_ros.messages.point_cloud import point_cloud
from physkin_ros.messages.serialised import SerialisedMessage

if TYPE_CHECKING:
    from rclpy.publisher import Publisher

__all__ = [
    "CLOUD_FIELDS",
    "GarmentCloud",
    "NodesMessage",
    "TriangleMarker",
    "body_covered",
    "garment_mesh",
    "gravity_direction",
    "read_cloud",
]

CLOUD_FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z")
FLOAT32 = 7  # sensor_msgs/PointField.FLOAT32
CLOTH_COLOUR = (0.36, 0.50, 0.70)


class GarmentCloud:
    """One `sensor_msgs/PointCloud2`, filled in place and published again and again.

    points: (n, 6) float32 view of its data, x, y, z [m] and unit normal.
    """

    def __init__(self, point_count: int, frame_id: str) -> None:
        records = np.dtype([(name, "f4") for name in CLOUD_FIELDS])
        kept = SerialisedMessage(
            lambda data: point_cloud(records, point_count, data, frame_id),  # a frame not finite is never published
            (point_count, len(CLOUD_FIELDS)),
            dtype=np.float32,
        )
        (self.points,), self.publish = kept.payloads, kept.publish


class NodesMessage:
    """One `physkin_msgs/GarmentNodes` of a garment, filled in place. transforms: (m, 3, 4) and detail_offsets: (D, 3)
    float32 views of its data."""

    def __init__(self, skinning: SkinningData, frame_id: str, revision: int) -> None:
        from physkin_msgs.msg import GarmentNodes

        def message_of(*values: bytes) -> GarmentNodes:
            transforms, detail_offsets = (array("f", each) for each in values)
            message = GarmentNodes(revision=revision, transforms=transforms, detail_offsets=detail_offsets)
            message.header.frame_id = frame_id
            return message

        shapes = (len(skinning.node_rest), 3, 4), (skinning.detail_node_count, 3)
        kept = SerialisedMessage(message_of, *shapes, dtype=np.float32)
        (self.transforms, self.detail_offsets), self.publish = kept.payloads, kept.publish


class TriangleMarker:
    """One `visualization_msgs/Marker` TRIANGLE_LIST of the garment's faces (f, 3), filled in place."""

    def __init__(self, faces: np.ndarray, frame_id: str, name: str) -> None:
        from geometry_msgs.msg import Point
        from visualization_msgs.msg import Marker

        def message_of(data: bytes) -> Marker:
            x, y, z = np.frombuffer(data, count=3).tolist()  # of every corner, `PERIOD` being as long
            points = [Point(x=x, y=y, z=z)] * faces.size
            message = Marker(ns=name, type=Marker.TRIANGLE_LIST, action=Marker.ADD, points=points)
            message.header.frame_id = frame_id
            message.pose.orientation.w = message.scale.x = message.scale.y = message.scale.z = message.color.a = 1.0
            message.color.r, message.color.g, message.color.b = CLOTH_COLOUR
            return message

        self._corners = faces.ravel()
        self._serialised = SerialisedMessage(message_of, (faces.size, 3), dtype=np.float64)

    def publish(self, publisher: Publisher, points: np.ndarray, sec: int, nanosec: int) -> None:
        """Publish the marker of a cloud (n, 6)."""
        (corners,) = self._serialised.payloads
        corners[:] = points[self._corners, :3]
        self._serialised.publish(publisher, sec, nanosec)


def read_cloud(message) -> np.ndarray:
    """The points of a garment cloud: (n, 6) float32 view of the message's data, x, y, z [m] and unit normal.

    Raises ValueError when the `sensor_msgs/PointCloud2` is not laid out as a garment cloud, or its data are too short.
    """
    layout = [(field.name, field.offset, field.datatype, field.count) for field in message.fields]
    expected = [(name, 4 * index, FLOAT32, 1) for index, name in enumerate(CLOUD_FIELDS)]
    if layout != expected or message.height != 1 or message.is_bigendian != (sys.byteorder == "big"):
        raise ValueError(f"no garment cloud: fields {layout}, height {message.height}; expected {expected}, height 1")
    if message.point_step < 4 * len(CLOUD_FIELDS) or len(message.data) < message.point_step * message.width:
        raise ValueError(f"{len(message.data)} bytes of data for {message.width} points of {message.point_step} bytes")
    shape, strides = (message.width, len(CLOUD_FIELDS)), (message.point_step, 4)
    return np.ndarray(shape, dtype=np.float32, buffer=message.data, strides=strides)


def body_covered(outfit: Outfit, index: int) -> np.ndarray:
    """(F,) bool, faces of the body that an outfit covers, sent with its innermost garment; empty with others, and where
    one garment is worn."""
    sent = index == 0 and len(outfit.layers) > 1
    return outfit.body_mask if sent else np.empty(0, dtype=bool)


def garment_mesh(outfit: Outfit, index: int, frame_id: str, *, revision: int = 1, avatar: str = ""):
    """The `physkin_msgs/GarmentMesh` of a garment of an outfit; the stamp is left to the caller."""
    from physkin_msgs.msg import GarmentMesh

    layer = outfit.layers[index]
    model, bound = layer.model, layer.bound_visible
    message = GarmentMesh(
        revision=revision,
        model_name=model.name,
        avatar=avatar,
        layer=index,
        layers=len(outfit.layers),
        moved=layer.moved,
        vertex_count=layer.vertex_count,
        model_vertex_count=len(layer.hidden),
        visible=array("I", layer.visible.astype(np.uint32).tobytes()),
        body_covered=array("B", body_covered(outfit, index).astype(np.uint8).tobytes()),
        faces=array("I", layer.faces.astype(np.uint32).tobytes()),
        rest_vertices=array("f", bound.vertices.tobytes()),
        rest_normals=array("f", bound.normals.tobytes()),
        node_count=len(bound.node_rest),
        node_rest=array("f", bound.node_rest.tobytes()),
        influences=bound.influence_nodes.shape[1],
        influence_nodes=array("I", bound.influence_nodes.astype(np.uint32).tobytes()),
        influence_weights=array("f", bound.influence_weights.tobytes()),
        joint_names=list(outfit.joint_names),
        joint_rest=array("f", model.rig.rest.astype(np.float32).tobytes()),
        detail_node_count=bound.detail_node_count,
        detail_influences=bound.detail_nodes.shape[1],
        detail_nodes=array("I", bound.detail_nodes.astype(np.uint32).tobytes()),
        detail_weights=array("f", bound.detail_weights.tobytes()),
    )
    message.header.frame_id = frame_id
    return message


def gravity_direction(value) -> np.ndarray:
    """A direction of gravity (3,) from three numbers of any length but zero. Raises ValueError."""
    if isinstance(value, (list, tuple, array)):
        value = list(value)
        numbers = all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in value)
        with np.errstate(over="ignore"):
            if numbers and len(value) == 3 and np.isfinite(value).all() and 1e-9 < np.linalg.norm(value) < np.inf:
                return np.array(value, dtype=np.float64)
    raise ValueError(f"gravity is {value!r}; it must be three finite numbers, not all zero, such as [0.0, 0.0, -1.0]")
