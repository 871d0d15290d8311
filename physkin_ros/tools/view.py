"""`physkin view --ros`: the garments that a running ROS node publishes, on a page in the browser."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, PointCloud2

from physkin_core import load_body_model
from physkin_core.file_reading import sentence, shown
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.loader.requests import LoadedAvatar
from physkin_core.outfit.dressing import MOST_LAYERS
from physkin_core.pictures.picture import BODY_COLOUR, layer_colours
from physkin_core.view.page import Page, Readout
from physkin_core.view.scene.heat_map import as_bytes, own_bands
from physkin_core.view.surface_node import SurfaceNode
from physkin_core.view.view import begin, end_at_sigterm
from physkin_ros.messages.conversions import read_cloud
from physkin_ros.messages.interfaces import missing_interfaces, missing_tf
from physkin_ros.messages.serialised import read_serialised
from physkin_ros.messages.topics import GARMENT, MESH
from physkin_ros.middleware.transport import use_shipped_profile
from physkin_ros.root.quaternions import OrientationError, Quaternion, Vector
from physkin_ros.root.tf_topics import TfListener
from physkin_ros.root.transform_tree import LONGEST_NAME, TransformTree

__all__ = ["RosPage", "show"]

CLOUD_TYPE, JOINTS_TYPE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/JointState"
CLOUDS, JOINTS = GARMENT.below(""), "/joint_states"
"""What the topics of garments and of bodies end in."""
LISTEN, LOOK_FOR_TOPICS, READ_OUT = 0.02, 1.0, 0.5
"""[s] Of each tick messages are taken for so long; the others are between one look and the next."""
MOST = 64
"""Garments, and bodies."""
POINT_SIZE = 0.006  # [m]
PELVIS = 0.95  # [m] above the floor, of a figure of which nobody says where it is
APART = 1.2  # [m] such figures stand


@dataclass
class Garment:
    """What is known of one. place: the scene's frame for it; frame_id: TF's. points: (n, 6) of its last cloud; drawn:
    whether the page has them; faces: (f, 3) of its last mesh, if one came; layer: in its outfit, of layers. surface:
    what is drawn of it, of so many vertices."""

    place: object
    frame_id: str = ""
    points: np.ndarray | None = None
    drawn: bool = False
    faces: np.ndarray | None = None
    layer: int = 0
    layers: int = 1
    surface: SurfaceNode | None = None
    vertex_count: int = 0


@dataclass
class Body:
    """place, frame_id, surface: as of a garment. positions: by joint name, of its last joint states [rad]."""

    place: object
    surface: SurfaceNode
    frame_id: str = ""
    positions: dict[str, float] = field(default_factory=dict)


class RosPage:
    """Draws every garment cloud of the ROS graph, topics `.../garment`; as cloth once the mesh beside it has come.

    node: a ROS node for this page alone. body: an avatar of the body model's rig, which is drawn for each topic
    `.../joint_states`; None: no bodies. All stand where TF says that their frame is, and the page looks at the middle
    of these; what TF does not know stands in a row. garments, bodies: by topic. tree: what TF has said.
    """

    def __init__(self, page: Page, node: Node, *, body: LoadedAvatar | None = None) -> None:
        self._page, self._node, self._readout = page, node, Readout(page)
        self._rig, self._loaded = load_body_model().rig, body
        self._own = own_bands(None if body is None else body.colours)
        self.garments: dict[str, Garment] = {}
        self.bodies: dict[str, Body] = {}
        self.tree, self._transforms = TransformTree(), None
        if not missing_tf():
            self._transforms = TfListener(node, lambda frames, static: self.tree.update(frames, static=static))
        self._faults: dict[str, str] = {}
        self._clouds, self._waited = 0, 0.0
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        node.create_timer(LOOK_FOR_TOPICS, self.look_for_topics)
        self.look_for_topics()

    def look_for_topics(self) -> None:
        """Subscribe to what has come, up to `MOST` of each, and to TF as it is offered."""
        for subscription in self._transforms.subscriptions if self._transforms else ():
            subscription.follow()
        for topic, types in self._node.get_topic_names_and_types():
            if CLOUD_TYPE in types and topic.endswith(CLOUDS) and topic not in self.garments:
                if len(self.garments) < MOST:
                    self._listen_to_garment(topic, self.add_garment(topic))
            elif JOINTS_TYPE in types and topic.endswith(JOINTS) and topic not in self.bodies and self._loaded:
                if len(self.bodies) < MOST:
                    take = self._guarded(topic, self._on_joints, self.add_body(topic))
                    whatever = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # of reliable ones, too
                    self._node.create_subscription(JointState, topic, take, whatever)

    def tick(self, seconds: float) -> None:
        """Take messages and draw what is new. Raises ValueError for those that are malformed, once each."""
        end = time.monotonic() + LISTEN
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)
        with self._page.server.atomic():
            for topic, garment in self.garments.items():
                if garment.points is not None and not garment.drawn:
                    self._guarded(topic, self._draw, garment)()
            for topic, body in self.bodies.items():
                self._guarded(topic, self._draw_body, topic, body)()
            self._place()
        self._waited += seconds
        if self._waited >= READ_OUT:
            self._read_out()
        if self._faults:
            told = "; ".join(f"{topic}: {fault}" for topic, fault in self._faults.items())
            self._faults.clear()
            raise ValueError(told)

    def close(self) -> None:
        """Take no more messages."""
        self._executor.shutdown()

    def add_garment(self, topic: str) -> Garment:
        """With a place in the scene."""
        place = self._page.server.scene.add_frame(f"/world/garment{len(self.garments)}", show_axes=False)
        return self.garments.setdefault(topic, Garment(place))

    def add_body(self, topic: str) -> Body:
        """The same."""
        place, avatar = f"/world/body{len(self.bodies)}", self._loaded.avatar
        surface = SurfaceNode(self._page.server, place, len(avatar.vertices), avatar.faces, BODY_COLOUR)
        return self.bodies.setdefault(topic, Body(self._page.server.scene.add_frame(place, show_axes=False), surface))

    def _guarded(self, topic: str, take: Callable, *first) -> Callable:
        """A function whose errors the next tick tells, and which end nothing else. first: arguments before its own."""

        def taken(*arguments) -> None:
            try:
                take(*first, *arguments)
            except Exception as error:
                kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
                self._faults[topic] = sentence(f"{kind}{error}")

        return taken

    def _listen_to_garment(self, topic: str, garment: Garment) -> None:
        take = self._guarded(topic, self._on_cloud, garment)
        self._node.create_subscription(PointCloud2, topic, take, 1)
        if not missing_interfaces():  # else clouds are drawn as points
            from physkin_msgs.msg import GarmentMesh

            take = self._guarded(topic, lambda data: self._on_mesh(garment, read_serialised(data, GarmentMesh)))
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            beside = MESH.below(topic.removesuffix(CLOUDS))
            self._node.create_subscription(GarmentMesh, beside, take, latched, raw=True)

    def _on_cloud(self, garment: Garment, cloud: PointCloud2) -> None:
        if len(cloud.header.frame_id) > LONGEST_NAME:
            raise ValueError(f"frame {shown(cloud.header.frame_id)} has more than {LONGEST_NAME} characters")
        garment.points, garment.frame_id, garment.drawn = read_cloud(cloud).copy(), cloud.header.frame_id, False
        self._clouds += 1

    def _on_mesh(self, garment: Garment, mesh) -> None:
        faces, name = np.array(mesh.faces, dtype=np.int64), shown(mesh.model_name)
        if len(faces) % 3:
            raise ValueError(f"mesh {name} has {len(faces)} indices of faces; allowed: three for each")
        if faces.max(initial=0) >= mesh.vertex_count:
            raise ValueError(f"mesh {name} has face index {faces.max(initial=0)} of {mesh.vertex_count} vertices")
        if not mesh.layer < mesh.layers <= MOST_LAYERS:
            allowed = f"allowed: 0 to {MOST_LAYERS - 1}, of up to {MOST_LAYERS}"
            raise ValueError(f"mesh {name} is layer {mesh.layer} of {mesh.layers}; {allowed}")
        garment.faces, garment.layer, garment.layers = faces.reshape(-1, 3), mesh.layer, mesh.layers
        garment.vertex_count = 0  # what is drawn is of another mesh

    def _on_joints(self, body: Body, state: JointState) -> None:
        known = set(self._rig.joint_names)
        body.positions.update((name, at) for name, at in zip(state.name, state.position) if name in known)

    def _draw(self, garment: Garment) -> None:
        """As cloth where its mesh is known, else as points."""
        garment.drawn, points = True, garment.points[:, :3]
        colour, server = layer_colours(garment.layers)[garment.layer], self._page.server
        if garment.vertex_count != len(points):
            if garment.surface is not None:
                garment.surface.remove()
            garment.surface, garment.vertex_count = None, len(points)
            server.scene.remove_by_name(f"{garment.place.name}/points")
            if garment.faces is not None and 0 <= garment.faces.max(initial=-1) < len(points):
                garment.surface = SurfaceNode(server, garment.place.name, len(points), garment.faces, colour)
        if garment.surface is not None:
            garment.surface.show(points)
        else:  # in place of those of the same name
            name, look = f"{garment.place.name}/points", {"point_size": POINT_SIZE, "precision": "float32"}
            server.scene.add_point_cloud(name, points, as_bytes(colour), **look)

    def _draw_body(self, topic: str, body: Body) -> None:
        """In the frame of clouds whose topic names the same avatar, or of the first ones."""
        avatar = topic.removesuffix(JOINTS).rpartition("/")[2]
        frames = {cloud: garment.frame_id for cloud, garment in self.garments.items() if garment.points is not None}
        if frames and body.positions:
            named = (frame for cloud, frame in frames.items() if avatar and avatar in cloud.split("/"))
            body.frame_id = next(named, next(iter(frames.values())))
            positions = self._rig.joint_positions(body.positions)
            bones = self._rig.bone_transforms(positions, heads=self._loaded.avatar.bone_heads)
            body.surface.show(self._loaded.avatar.posed_vertices(bones), *self._own)

    def _place(self) -> None:
        """Everything where its frame is."""
        places: dict[str, tuple | None] = {}
        for garment in self.garments.values():
            if garment.points is not None:
                places[garment.frame_id] = self._place_in_tf(garment.frame_id)
        if known := [place for place, _ in filter(None, places.values())]:
            x, y, _ = np.mean(known, axis=0).tolist()
            self._page.world.position = (-x, -y, 0.0)  # the floor moves in the camera's place
        unknown = [frame_id for frame_id, place in places.items() if place is None]
        for row, frame_id in enumerate(unknown):
            places[frame_id] = (0.0, APART * (row - (len(unknown) - 1) / 2), PELVIS), (0.0, 0.0, 0.0, 1.0)
        for each in (*self.garments.values(), *self.bodies.values()):
            if each.frame_id in places:
                each.place.position, (x, y, z, w) = places[each.frame_id]
                each.place.wxyz = (w, x, y, z)

    def _place_in_tf(self, frame_id: str) -> tuple[Vector, Quaternion] | None:
        """In the uppermost of TF's frames above it; None where TF does not know it."""
        try:
            world = self.tree.top(frame_id)
            return None if world == frame_id else self.tree.pose(frame_id, world)[1:]
        except OrientationError:
            return None

    def _read_out(self) -> None:
        counts = {topic: 0 if each.points is None else len(each.points) for topic, each in self.garments.items()}
        rows = {topic: f"{count} points" for topic, count in counts.items()} or {"garments": "none is published yet"}
        self._readout.show(rows | {"clouds a second": f"{self._clouds / self._waited:.0f}"})
        self._clouds, self._waited = 0, 0.0


def show(options: argparse.Namespace) -> int:
    """What `physkin view --ros` does with its options. Returns 0."""
    end_at_sigterm()
    use_shipped_profile()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # Ctrl+C ends the page, and that this
    body = None
    if options.avatar is not None:
        with closing(AssetLoader()) as loader:
            body = loader.avatar(options.avatar, rig_file=options.rig, bones=options.bones)
    page, node = Page(host=options.host, port=options.port, title="PhySkin, ROS"), rclpy.create_node("physkin_view")
    drawn = RosPage(page, node, body=body)
    try:
        begin(page, browser=not options.no_browser)
        page.run(drawn.tick)
    finally:
        drawn.close()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0
