"""A reader of garment clouds with rclpy and NumPy alone: `python read_clouds.py [/drape_node/tshirt/garment]`."""

import sys

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import PointCloud2


def show(cloud: PointCloud2) -> None:
    """Say where the garment is; a renderer would draw the vertices."""
    record = {"names": [field.name for field in cloud.fields], "offsets": [field.offset for field in cloud.fields]}
    record |= {"formats": ["f4"] * len(cloud.fields), "itemsize": cloud.point_step}
    vertices = np.frombuffer(cloud.data, np.dtype(record))  # a view: x, y, z [m] and normal_x, normal_y, normal_z
    lowest, highest = vertices["z"].min(), vertices["z"].max()
    print(f"{cloud.header.frame_id}: {len(vertices)} vertices, {lowest:.3f} to {highest:.3f} m high", flush=True)


rclpy.init()
node = rclpy.create_node("cloud_reader")
node.create_subscription(PointCloud2, sys.argv[1] if len(sys.argv) > 1 else "/drape_node/garment", show, 5)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
