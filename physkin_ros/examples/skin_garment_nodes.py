"""A reader that skins by itself: `python skin_garment_nodes.py [/drape_node/alice/top]`. Needs physkin_msgs."""

import sys

import rclpy
from rclpy.executors import ExternalShutdownException

from physkin_ros.client import GarmentClient, GarmentFrame


def show(frame: GarmentFrame) -> None:
    """Say where the garment is; a renderer would draw `frame.points` and `frame.faces`."""
    centre = frame.points[:, :3].mean(axis=0)
    print(f"{frame.header.frame_id}: {len(frame.points)} vertices around {centre.round(3).tolist()} m")


rclpy.init()
node = rclpy.create_node("garment_client")
client = GarmentClient(node, show, topics=sys.argv[1] if len(sys.argv) > 1 else "/drape_node")
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
