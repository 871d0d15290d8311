"""`physkin view --ros`: the garments that a running ROS node publishes, on a page in the browser."""

from __future__ import annotations

import argparse
import threading
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, PointCloud2

from physkin_core import load_body_model
from physkin_core.file_reading import sentence, shown
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.loader.requests import LoadedAvatar
from physkin_core.outfit.dressing import MOST_LAYERS
from physkin_core.picture import BODY_COLOUR, layer_colours
from physkin_core.view.page import Page, Readout
from physkin_core.view.scene.heat_map import own_bands
from physkin_core.view.surface_node import SurfaceNode
from physkin_core.view.view import begin, end_at_sigterm
from physkin_ros.messages.conversions import read_cloud
from physkin_ros.messages.interfaces import missing_tf
from physkin_ros.messages.serialised import read_serialised
from physkin_ros.messages.topics import GARMENT, MESH
from physkin_ros.middleware.transport import use_shipped_profile
from physkin_ros.root.quaternions import OrientationError, Quaternion, Vector
from physkin_ros.root.tf_topics import TfListener
from physkin_ros.root.transform_tree import LONGEST_NAME, TransformTree

__all__ = ["BodySeen", "CloudListener", "GarmentSeen", "RosPage", "show"]

MESH_TYPE, CLOUD_TYPE = "physkin_msgs/msg/GarmentMesh", "sensor_msgs/msg/PointCloud2"
LOOK_FOR_TOPICS, READ_OUT = 1.0, 0.5
"""[s]"""
MOST_GARMENTS = 64
"""As many are shown; frames of TF that they are in are as many, too."""
POINT_SIZE = 0.006  # [m]
PELVIS = 0.95  # [m] above the floor, of a figure of which nobody says where it is
APART = 1.2  # [m] such figures stand


@dataclass
class GarmentSeen:
    """What is known of one garment. points: (n, 6) of its last cloud; frame_id: that it is in; faces: (f, 3) of its
    last mesh, if one came; layer: in its outfit; layers: garments of that. clouds: how many came; drawn: how many of
    them were shown."""

    points: np.ndarray | None = None
    frame_id: str = ""
    faces: np.ndarray | None = None
    layer: int = 0
    layers: int = 1
    clouds: int = 0
    drawn: int = 0
    fault: str = ""


@dataclass
class BodySeen:
    """A body by its joint states. positions: by joint name, of the last ones [rad]. avatar: id that the topic says."""

    avatar: str
    positions: dict[str, float] = field(default_factory=dict)


class CloudListener(Node):
    """Subscribes to every garment cloud of the ROS graph, topics `.../garment`, to the mesh beside it, and to TF.

    joint_states: topics, one for a body. arguments: as `rclpy.node.Node` takes them. garments, bodies: by topic. They
    change while the node is spun.
    """

    def __init__(self, joint_states: Sequence[str] = ("joint_states",), **arguments) -> None:
        super().__init__("physkin_view", **arguments)
        self.garments: dict[str, GarmentSeen] = {}
        self._joint_names = frozenset(load_body_model().rig.joint_names)
        self.bodies = {topic: BodySeen(_avatar_of(topic)) for topic in joint_states}
        self._latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        whatever = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # of reliable publishers, too
        for topic, body in self.bodies.items():
            self.create_subscription(JointState, topic, lambda state, body=body: self._on_joints(body, state), whatever)
        self._tree, self._tree_lock = TransformTree(), threading.Lock()
        self._transforms = None if missing_tf() else TfListener(self, self._on_transforms)
        self.create_timer(LOOK_FOR_TOPICS, self.look_for_topics)
        self.look_for_topics()

    def look_for_topics(self) -> None:
        """Subscribe to what has come, the first `MOST_GARMENTS`, and to TF as it is offered."""
        for subscription in self._transforms.subscriptions if self._transforms else ():
            subscription.follow()
        end = GARMENT.below("")
        for topic, types in self.get_topic_names_and_types():
            if len(self.garments) >= MOST_GARMENTS:
                return
            if CLOUD_TYPE in types and topic.endswith(end) and topic not in self.garments:
                seen = self.garments[topic] = GarmentSeen()
                self.create_subscription(PointCloud2, topic, lambda cloud, seen=seen: self._on_cloud(seen, cloud), 1)
                self._subscribe_to_mesh(MESH.below(topic.removesuffix(end)), seen)

    def place(self, frame_id: str) -> tuple[Vector, Quaternion] | None:
        """Where a frame is in the uppermost of TF's above it; None where TF does not know it."""
        with self._tree_lock:
            try:
                world = self._tree.top(frame_id)
                return None if world == frame_id else self._tree.pose(frame_id, world)[1:]
            except OrientationError:
                return None

    def frame_of(self, avatar: str) -> str | None:
        """The frame of the clouds whose topic names an avatar's id, else of the first; None before there are any."""
        seen = {topic: each.frame_id for topic, each in self.garments.items() if each.points is not None}
        named = (frame for topic, frame in seen.items() if avatar and avatar in topic.split("/"))
        return next(named, next(iter(seen.values()), None))

    def _on_transforms(self, transforms, static: bool) -> None:
        with self._tree_lock:
            self._tree.update(transforms, static=static)

    def _subscribe_to_mesh(self, topic: str, seen: GarmentSeen) -> None:
        try:
            from physkin_msgs.msg import GarmentMesh
        except ImportError:
            return  # clouds are shown as points

        def on_data(data: bytes) -> None:
            try:
                self._on_mesh(seen, read_serialised(data, GarmentMesh))
            except ValueError as error:
                seen.fault = str(error)

        self.create_subscription(GarmentMesh, topic, on_data, self._latched, raw=True)

    def _on_cloud(self, seen: GarmentSeen, cloud: PointCloud2) -> None:
        try:
            if len(cloud.header.frame_id) > LONGEST_NAME:
                raise ValueError(f"frame {shown(cloud.header.frame_id)} has more than {LONGEST_NAME} characters")
            seen.points, seen.frame_id = read_cloud(cloud).copy(), cloud.header.frame_id
            seen.clouds += 1
        except ValueError as error:
            seen.fault = str(error)

    def _on_mesh(self, seen: GarmentSeen, mesh) -> None:
        faces, name = np.array(mesh.faces, dtype=np.int64), shown(mesh.model_name)
        if len(faces) % 3:
            seen.fault = f"mesh {name} has {len(faces)} indices of faces; allowed: three for each"
        elif faces.size and faces.max() >= mesh.vertex_count:
            seen.fault = f"mesh {name} has face index {faces.max()} of {mesh.vertex_count} vertices"
        elif not mesh.layer < mesh.layers <= MOST_LAYERS:
            seen.fault = f"mesh {name} is layer {mesh.layer} of {mesh.layers}; allowed: 0 to 3, of up to {MOST_LAYERS}"
        else:
            seen.faces, seen.layer, seen.layers = faces.reshape(-1, 3), mesh.layer, mesh.layers

    def _on_joints(self, body: BodySeen, message: JointState) -> None:
        known = self._joint_names
        body.positions.update((name, at) for name, at in zip(message.name, message.position) if name in known)


def _avatar_of(topic: str) -> str:
    """An avatar's id, of the joint states below it."""
    *_, avatar, _ = ["", *topic.split("/")]
    return avatar


class RosPage:
    """Draws what a listener has. body: an avatar of the body model's rig, whose joint states are shown too, or None.

    What is in one frame is a figure. It stands where TF says, and the page looks at the middle of all such; figures
    that TF does not know stand in a row.
    """

    def __init__(self, page: Page, listener: CloudListener, *, body: LoadedAvatar | None = None) -> None:
        self._page, self._listener = page, listener
        self._readout = Readout(page)
        self._rig = load_body_model().rig
        self._avatar = None if body is None else body.avatar
        self._own = own_bands(None if body is None else body.colours)
        self._bodies: dict[str, tuple[str, SurfaceNode]] = {}
        self._cloths: dict[str, tuple[object, np.ndarray | None, int]] = {}
        self._figures: dict[str, object] = {}
        self._counted, self._waited = 0, 0.0

    def tick(self, seconds: float) -> None:
        """Draw what is new. Raises ValueError for a garment whose messages are malformed, once each."""
        faults = []
        with self._page.server.atomic():
            for topic, seen in list(self._listener.garments.items()):
                if seen.clouds != seen.drawn:
                    seen.drawn = seen.clouds
                    try:
                        self._draw(topic, seen)
                    except ValueError as error:
                        seen.fault = str(error)
                if seen.fault:
                    faults.append(f"{topic}: {seen.fault}")
                    seen.fault = ""
            for topic, body in self._listener.bodies.items():
                try:
                    self._draw_body(topic, body)
                except ValueError as error:
                    faults.append(str(error))
            self._place_figures()
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
        colour, place = layer_colours(seen.layers)[seen.layer], f"{self._figure(seen.frame_id)}{topic}"
        if seen.faces is None or not len(seen.faces) or seen.faces.max() >= len(points):
            tint = tuple(round(255 * channel) for channel in colour)
            return self._page.server.scene.add_point_cloud(
                place, points, tint, point_size=POINT_SIZE, precision="float32"
            )
        surface = SurfaceNode(self._page.server, place, len(points), seen.faces, colour)
        surface.show(points)
        return surface

    def _figure(self, frame_id: str) -> str:
        """Name of the scene's frame for a frame of TF. Raises ValueError where there are too many."""
        if frame_id not in self._figures:
            if len(self._figures) >= MOST_GARMENTS:
                raise ValueError(f"frame {shown(frame_id)} is left out: clouds have come in {MOST_GARMENTS} already")
            name = f"/world/figure{len(self._figures)}"
            self._figures[frame_id] = self._page.server.scene.add_frame(name, show_axes=False)
        return self._figures[frame_id].name

    def _place_figures(self) -> None:
        places = {frame_id: self._listener.place(frame_id) for frame_id in self._figures}
        unknown = [frame_id for frame_id, place in places.items() if place is None]
        for frame_id, figure in self._figures.items():
            if places[frame_id] is None:
                row = unknown.index(frame_id) - (len(unknown) - 1) / 2
                figure.position, figure.wxyz = (0.0, APART * row, PELVIS), (1.0, 0.0, 0.0, 0.0)
            else:
                place, (x, y, z, w) = places[frame_id]
                figure.position, figure.wxyz = place, (w, x, y, z)
        if known := [place[0] for place in places.values() if place is not None]:
            x, y, _ = np.mean(known, axis=0).tolist()
            self._page.world.position = (-x, -y, 0.0)  # the floor moves in the camera's place

    def _draw_body(self, topic: str, seen: BodySeen) -> None:
        frame_id = self._listener.frame_of(seen.avatar)
        if self._avatar is None or frame_id is None:
            return
        known = {name: seen.positions.get(name) for name in self._rig.joint_names}
        positions = self._rig.joint_positions({name: value for name, value in known.items() if value is not None})
        bones = self._rig.bone_transforms(positions, heads=self._avatar.bone_heads)
        before, body = self._bodies.get(topic, ("", None))
        if before != frame_id:
            if body is not None:  # the clouds that bear its name came later than others
                body.remove()
            avatar, name = self._avatar, f"{self._figure(frame_id)}/body{topic}"
            body = SurfaceNode(self._page.server, name, len(avatar.vertices), avatar.faces, BODY_COLOUR)
            self._bodies[topic] = frame_id, body
        body.paint(*self._own, self._avatar.posed_vertices(bones))

    def _read_out(self) -> None:
        seen = self._listener.garments
        count = sum(each.clouds for each in seen.values())
        rows = {topic: f"{0 if each.points is None else len(each.points)} points" for topic, each in seen.items()}
        rows["clouds a second"] = f"{(count - self._counted) / self._waited:.0f}"
        self._counted, self._waited = count, 0.0
        self._readout.show(rows if seen else {"garments": "none is published yet"})


def _spin(executor: SingleThreadedExecutor, listener: CloudListener) -> None:
    """Serve callbacks until the executor or ROS is shut down; what one of them raises ends that one alone."""
    while True:
        try:
            executor.spin()
            return
        except ExternalShutdownException:
            return
        except Exception as error:
            what = sentence(f"a message could not be shown: {type(error).__name__}: {error}")
            listener.get_logger().error(what, throttle_duration_sec=1.0)


def show(options: argparse.Namespace) -> int:
    """What `physkin view --ros` does with its options. Returns 0."""
    end_at_sigterm()
    use_shipped_profile()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # Ctrl+C ends the page, and that this
    listener = CloudListener(options.joint_states or ["joint_states"])
    body = None
    if options.avatar is not None:
        with closing(AssetLoader()) as loader:
            body = loader.avatar(options.avatar, rig_file=options.rig)
    page = Page(host=options.host, port=options.port, title="PhySkin, ROS")
    drawn = RosPage(page, listener, body=body)
    executor = SingleThreadedExecutor()
    executor.add_node(listener)
    spinning = threading.Thread(target=_spin, args=(executor, listener), daemon=True)
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
