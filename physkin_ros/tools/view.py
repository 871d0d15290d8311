"""`physkin view --ros`: the garments that a running ROS node publishes, on a page in the browser."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from dataclasses import dataclass

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, PointCloud2

from physkin_core import load_avatar, load_body_model
from physkin_core.picture import BODY_COLOUR, layer_colours
from physkin_core.view.command import begin
from physkin_core.view.page import Page
from physkin_core.view.readout import Readout
from physkin_core.view.surface_node import SurfaceNode
from physkin_ros.messages.conversions import read_cloud
from physkin_ros.middleware.transport import use_shipped_profile

__all__ = ["CloudListener", "GarmentSeen", "RosPage", "show"]

MESH_TYPE, CLOUD_TYPE = "physkin_msgs/msg/GarmentMesh", "sensor_msgs/msg/PointCloud2"
LOOK_FOR_TOPICS, READ_OUT = 1.0, 0.5
"""[s]"""
POINT_SIZE = 0.006  # [m]


@dataclass
class GarmentSeen:
    """What is known of one garment. points: (n, 6) of its last cloud; faces: (f, 3) of its last mesh, if one came;
    layer: in its outfit; layers: garments of that. clouds: how many came; drawn: how many of them were shown."""

    points: np.ndarray | None = None
    faces: np.ndarray | None = None
    layer: int = 0
    layers: int = 1
    clouds: int = 0
    drawn: int = 0
    fault: str = ""


class CloudListener(Node):
    """Subscribes to every garment cloud of the ROS graph, topics `.../garment`, and to the mesh beside it.

    garments: by topic. joint_positions: by name, of the last joint state on `joint_states`. Both change while the node
    is spun.
    """

    def __init__(self, joint_states: str = "joint_states") -> None:
        super().__init__("physkin_view")
        self.garments: dict[str, GarmentSeen] = {}
        self.joint_positions: dict[str, float] = {}
        self._latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(JointState, joint_states, self._on_joints, 1)
        self.create_timer(LOOK_FOR_TOPICS, self.look_for_topics)
        self.look_for_topics()

    def look_for_topics(self) -> None:
        """Subscribe to what has come."""
        for topic, types in self.get_topic_names_and_types():
            if CLOUD_TYPE in types and topic.endswith("/garment") and topic not in self.garments:
                seen = self.garments[topic] = GarmentSeen()
                self.create_subscription(PointCloud2, topic, lambda cloud, seen=seen: self._on_cloud(seen, cloud), 1)
                self._subscribe_to_mesh(topic.removesuffix("garment") + "mesh", seen)

    def _subscribe_to_mesh(self, topic: str, seen: GarmentSeen) -> None:
        try:
            from physkin_msgs.msg import GarmentMesh
        except ImportError:
            return  # clouds are shown as points
        self.create_subscription(GarmentMesh, topic, lambda mesh: self._on_mesh(seen, mesh), self._latched)

    def _on_cloud(self, seen: GarmentSeen, cloud: PointCloud2) -> None:
        try:
            seen.points = read_cloud(cloud).copy()
            seen.clouds += 1
        except ValueError as error:
            seen.fault = str(error)

    def _on_mesh(self, seen: GarmentSeen, mesh) -> None:
        faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
        if faces.size and faces.max() >= mesh.vertex_count:
            seen.fault = f"mesh {mesh.model_name!r} has face index {faces.max()} of {mesh.vertex_count} vertices"
            return
        seen.faces, seen.layer, seen.layers = faces, mesh.layer, mesh.layers

    def _on_joints(self, message: JointState) -> None:
        self.joint_positions.update(zip(message.name, message.position))


class RosPage:
    """Draws what a listener has. body: avatar file whose joint states are shown too, or None."""

    def __init__(self, page: Page, listener: CloudListener, *, body: str | None = None, rig_file=None) -> None:
        self._page, self._listener = page, listener
        self._readout = Readout(page)
        self._rig = load_body_model().rig
        self._avatar = None if body is None else load_avatar(body, self._rig, rig_file=rig_file)
        self._body: SurfaceNode | None = None
        self._cloths: dict[str, tuple[object, np.ndarray | None, int]] = {}
        self._counted, self._waited = 0, 0.0
        page.figure.position = (0.0, 0.0, 0.95)  # clouds are in the root frame

    def tick(self, seconds: float) -> None:
        """Draw what is new. Raises ValueError for a garment whose messages are malformed, once each."""
        faults = []
        with self._page.server.atomic():
            for topic, seen in list(self._listener.garments.items()):
                if seen.clouds != seen.drawn:
                    seen.drawn = seen.clouds
                    self._draw(topic, seen)
                if seen.fault:
                    faults.append(f"{topic}: {seen.fault}")
                    seen.fault = ""
            self._draw_body()
        self._waited += seconds
        if self._waited >= READ_OUT:
            self._read_out()
        if faults:
            raise ValueError("; ".join(faults))

    def _draw(self, topic: str, seen: GarmentSeen) -> None:
        points = seen.points[:, :3]
        node, faces, count = self._cloths.get(topic, (None, None, 0))
        if node is None or faces is not seen.faces or count != len(points):
            if node is not None:
                node.remove()
            node = self._added(topic, seen, points)
            self._cloths[topic] = node, seen.faces, len(points)
        elif isinstance(node, SurfaceNode):
            node.show(points)
        else:
            node.points = points

    def _added(self, topic: str, seen: GarmentSeen, points: np.ndarray):
        """A surface where its mesh is known, else points."""
        colour, place = layer_colours(seen.layers)[seen.layer], f"/world/figure{topic}"
        if seen.faces is None or not len(seen.faces) or seen.faces.max() >= len(points):
            tint = tuple(round(255 * channel) for channel in colour)
            return self._page.server.scene.add_point_cloud(
                place, points, tint, point_size=POINT_SIZE, precision="float32"
            )
        surface = SurfaceNode(self._page.server, place, len(points), seen.faces, colour)
        surface.show(points)
        return surface

    def _draw_body(self) -> None:
        if self._avatar is None:
            return
        known = {name: self._listener.joint_positions.get(name) for name in self._rig.joint_names}
        positions = self._rig.joint_positions({name: value for name, value in known.items() if value is not None})
        bones = self._rig.bone_transforms(positions, heads=self._avatar.bone_heads)
        if self._body is None:
            faces = self._avatar.faces
            self._body = SurfaceNode(
                self._page.server, "/world/figure/body", len(self._avatar.vertices), faces, BODY_COLOUR
            )
        self._body.show(self._avatar.posed_vertices(bones))

    def _read_out(self) -> None:
        seen = self._listener.garments
        count = sum(each.clouds for each in seen.values())
        rows = {topic: f"{0 if each.points is None else len(each.points)} points" for topic, each in seen.items()}
        rows["clouds a second"] = f"{(count - self._counted) / self._waited:.0f}"
        self._counted, self._waited = count, 0.0
        self._readout.show(rows if seen else {"garments": "none is published yet"})


def show(options: argparse.Namespace) -> int:
    """What `physkin view --ros` does with its options. Returns 0."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    use_shipped_profile()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # Ctrl+C ends the page, and that this
    listener = CloudListener(options.joint_states)
    page = Page(host=options.host, port=options.port, title="PhySkin, ROS")
    drawn = RosPage(page, listener, body=options.avatar, rig_file=options.rig)
    executor = SingleThreadedExecutor()
    executor.add_node(listener)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    try:
        begin(page, browser=not options.no_browser)
        page.run(drawn.tick)
    finally:
        executor.shutdown()
        spinning.join()
        listener.destroy_node()
        rclpy.try_shutdown()
    return 0
