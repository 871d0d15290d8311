"""Between ROS messages and the core's arrays: gravity in; clouds, meshes and garment nodes out.

Dimensions: `n` garment vertices, `m` garment nodes. Metres, root frame.
"""

from __future__ import annotations

import sys
from array import array

import numpy as np

from physkin_core import Draper

__all__ = [
    "CLOUD_FIELDS",
    "GarmentCloud",
    "garment_description",
    "gravity_direction",
    "read_cloud",
]

CLOUD_FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z")
FLOAT32 = 7  # sensor_msgs/PointField.FLOAT32


class GarmentCloud:
    """One `sensor_msgs/PointCloud2`, filled in place and published again and again.

    message: the message; set its stamp. points: (n, 6) float32 view of its data, x, y, z [m] and unit normal.
    """

    def __init__(self, point_count: int, frame_id: str) -> None:
        from sensor_msgs.msg import PointCloud2, PointField

        step = 4 * len(CLOUD_FIELDS)
        fields = [PointField(name=name, offset=4 * i, datatype=FLOAT32, count=1) for i, name in enumerate(CLOUD_FIELDS)]
        self.message = PointCloud2(
            height=1,
            width=point_count,
            fields=fields,
            is_bigendian=sys.byteorder == "big",
            point_step=step,
            row_step=step * point_count,
            data=array("B", bytes(step * point_count)),
            is_dense=True,
        )
        self.message.header.frame_id = frame_id
        self.points = np.frombuffer(self.message.data, dtype=np.float32).reshape(point_count, len(CLOUD_FIELDS))


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


def garment_description(draper: Draper, frame_id: str):
    """The `physkin_msgs/GarmentDescription` of what a draper publishes; the stamp is left to the caller."""
    from physkin_msgs.msg import GarmentDescription

    model = draper.model
    message = GarmentDescription(
        model_name=model.name,
        vertex_count=draper.vertex_count,
        faces=array("I", draper.faces.astype(np.uint32).tobytes()),
        rest_vertices=array("f", draper.bound.vertices.astype(np.float32).tobytes()),
        node_count=len(model.node_rest),
        joint_names=list(draper.joint_names),
        joint_rest=array("f", model.rig.rest.astype(np.float32).tobytes()),
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
