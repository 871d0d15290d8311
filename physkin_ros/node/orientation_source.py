"""The subscriptions that tell an avatar where down is, and what it feels when its root is accelerated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu

from physkin_core import Sway
from physkin_core.runtime.draper import in_units_of_gravity
from physkin_ros.messages.conversions import gravity_direction
from physkin_ros.node.garment_stream import stream_quality
from physkin_ros.node.orientation import TransformTree, gravity_from_imu, gravity_from_quaternion
from physkin_ros.node.settings import AvatarSettings, SettingsError

__all__ = ["OrientationSource"]

SENSOR_QUEUE = 50  # of a sensor, while the machine is busy

Taker = Callable[[np.ndarray, int], None]
"""Takes what a message says (3,) and its stamp [ns]."""


class OrientationSource:
    """Calls back with what messages say, and their stamps, or with why one says nothing.

    on_gravity: takes gravity's unit direction. on_felt: takes effective gravity in units of gravity, from its topic, or
    as poses of the root sway cloth, until the topic has told one. tree: the TF tree
    of orientation tf, to be asked for every joint state; else None.
    Raises SettingsError for orientation tf without tf2_msgs.
    """

    def __init__(
        self, node, avatar: AvatarSettings, on_gravity: Taker, on_felt: Taker, on_bad: Callable[[str], None]
    ) -> None:
        self.tree: TransformTree | None = None
        self._node, self._on_bad = node, on_bad
        self._subscriptions = []
        below = f"~/{avatar.id}" if avatar.id else "~"
        topic = avatar.effective_gravity_topic or f"{below}/effective_gravity"
        swings = avatar.orientation == "pose" and avatar.sway > 0
        self._sway = Sway(amount=avatar.sway) if swings else None
        self._on_felt = on_felt
        self._listen(Vector3Stamped, topic, self._told, on_felt, sensor=True)
        kinds = {
            "gravity": (Vector3Stamped, lambda message: _from_vector(message.vector)),
            "pose": (PoseStamped, self._from_pose),
            "imu": (Imu, gravity_from_imu),
        }
        if avatar.orientation in kinds:
            kind, read = kinds[avatar.orientation]
            default = f"{avatar.id}/{avatar.orientation}" if avatar.id else avatar.orientation
            self._listen(kind, avatar.orientation_topic or default, read, on_gravity, sensor=kind is Imu)
        elif avatar.orientation == "tf":
            try:
                from tf2_msgs.msg import TFMessage
            except ModuleNotFoundError:
                raise SettingsError(
                    f"parameter {avatar.prefix}orientation is 'tf', which needs the package tf2_msgs (apt: "
                    "ros-jazzy-tf2-msgs); allowed without it: gravity, pose, imu, joints, fixed"
                ) from None
            tree = self.tree = TransformTree()
            latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            for topic, quality in (("/tf", QoSProfile(depth=100)), ("/tf_static", latched)):
                self._subscriptions.append(
                    node.create_subscription(TFMessage, topic, lambda message: tree.update(message.transforms), quality)
                )

    def close(self) -> None:
        """Stop listening."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _told(self, message: Vector3Stamped) -> np.ndarray:
        felt = in_units_of_gravity([message.vector.x, message.vector.y, message.vector.z])
        self._sway = None  # who tells it knows better
        return felt

    def _from_pose(self, message: PoseStamped) -> np.ndarray:
        place, turn, stamp = message.pose.position, message.pose.orientation, message.header.stamp
        down = gravity_from_quaternion((turn.x, turn.y, turn.z, turn.w))
        if self._sway is not None:
            root = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
            felt = in_units_of_gravity(self._sway.felt(stamp.sec + 1e-9 * stamp.nanosec, root))
            self._on_felt(felt.astype(np.float32), stamp.sec * 1_000_000_000 + stamp.nanosec)
        return down

    def _listen(self, kind: type, topic: str, read: Callable, take: Taker, *, sensor: bool) -> None:
        """sensor: the topic's publishers may be best effort, as sensor drivers are."""

        def on_message(message) -> None:
            try:
                found = read(message)
            except ValueError as error:
                self._on_bad(str(error))
            else:
                stamp = message.header.stamp
                take(found.astype(np.float32), stamp.sec * 1_000_000_000 + stamp.nanosec)

        quality = stream_quality(SENSOR_QUEUE, reliable=False) if sensor else stream_quality()
        self._subscriptions.append(self._node.create_subscription(kind, topic, on_message, **quality))


def _from_vector(vector) -> np.ndarray:
    down = gravity_direction([vector.x, vector.y, vector.z])
    return down / np.linalg.norm(down)
