"""`sensor_msgs/PointCloud2` of any records."""

from __future__ import annotations

import sys
from array import array

import numpy as np

__all__ = ["cloud_fields", "point_cloud"]

DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""Of a `sensor_msgs/PointField`."""


def point_cloud(records: np.dtype, count: int, data: bytes, frame_id: str):
    """A message of `count` records of numbers, in this machine's byte order, that are all finite. data: their bytes."""
    from sensor_msgs.msg import PointCloud2

    message = PointCloud2(
        height=1,
        width=count,
        fields=cloud_fields(records),
        is_bigendian=sys.byteorder == "big",
        point_step=records.itemsize,
        row_step=records.itemsize * count,
        data=array("B", data),
        is_dense=True,
    )
    message.header.frame_id = frame_id
    return message


def cloud_fields(records: np.dtype) -> list:
    """The `sensor_msgs/PointField`s of such records."""
    from sensor_msgs.msg import PointField

    found = [(name, *records.fields[name][:2]) for name in records.names]
    return [PointField(name=name, offset=at, datatype=DATATYPES[kind.str[1:]], count=1) for name, kind, at in found]
