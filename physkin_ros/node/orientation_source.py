"""The subscriptions that tell an avatar where down is, and what it feels when its root is accelerated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import monotonic_ns

import numpy as np
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from physkin_core.sway.frame_input import LARGEST_EFFECTIVE_GRAVITY, STANDARD_GRAVITY, RootSample
from physkin_ros.messages.interfaces import missing_tf
from physkin_ros.messages.topics import EFFECTIVE_GRAVITY, TOPICS
from physkin_ros.middleware.quality_of_service import FollowingSubscription
from physkin_ros.node.settings import AvatarSettings, SettingsError
from physkin_ros.root.gravity import FRESH, EffectiveGravity
from physkin_ros.root.quaternions import quaternion_of, vector_of
from physkin_ros.root.root_orientation import DirectionTaker, MotionTaker, RootOrientation, stamp_of
from physkin_ros.root.tf_topics import FollowedTransforms, RootBroadcaster

__all__ = ["OrientationSource", "check_orientation"]


def check_orientation(avatar: AvatarSettings) -> None:
    """Raises SettingsError for what needs `tf2_msgs` where that is not installed."""
    asked = {"orientation is 'tf'": avatar.orientation == "tf", "publish_tf is true": avatar.publish_tf}
    for text in (text for text, wanted in asked.items() if wanted):
        if missing := missing_tf():
            raise SettingsError(f"parameter {avatar.prefix}{text}, but {missing}")


class OrientationSource:
    """Calls back with what messages say, and their stamps, or with why one says nothing.

    on_gravity: takes gravity's unit direction (3,). on_motion: takes how the root moves, from the topic of effective
    gravity, or, while that gives none that is fresh, from the root's poses or an IMU.
    """

    def __init__(
        self,
        node,
        avatar: AvatarSettings,
        transforms: FollowedTransforms,
        on_gravity: DirectionTaker,
        on_motion: MotionTaker,
        on_bad: Callable[[str], None],
    ) -> None:
        self._transforms, self._follows_tf = transforms, False
        self._node, self._on_motion, self._on_bad = node, on_motion, on_bad
        self._frames = avatar.frame_id, avatar.world_frame
        self._subscriptions: list[FollowingSubscription] = []
        self._root = RootOrientation(on_gravity, self._move, imu_delay=avatar.imu_delay)
        self._received_until = 0  # [ns], monotonic: until then effective gravity as received counts
        self._broadcaster = None
        topic = avatar.effective_gravity_topic or EFFECTIVE_GRAVITY.of(avatar.id)
        self._listen(Vector3Stamped, topic, self._on_effective_gravity)
        kinds = {
            "gravity": (Vector3Stamped, self._root.direction),
            "pose": (PoseStamped, self._on_pose),
            "odometry": (Odometry, self._on_odometry),
            "imu": (Imu, self._root.imu),
        }
        if avatar.orientation in kinds:
            kind, take = kinds[avatar.orientation]
            default = next(topic for topic in TOPICS if topic.name == avatar.orientation).of(avatar.id)
            self._listen(kind, avatar.orientation_topic or default, take)
        if avatar.publish_tf:
            self._broadcaster = RootBroadcaster(node, frame_id=avatar.frame_id, world_frame=avatar.world_frame)
        if avatar.orientation == "tf":
            self._left_out = ""
            self._follows_tf = True
            transforms.follow(self._on_transforms)
            self._on_transforms({})

    @property
    def subscriptions(self) -> list[FollowingSubscription]:
        """All that it listens to, those of TF, which other avatars share, too."""
        return [*self._subscriptions, *(self._transforms.subscriptions if self._follows_tf else ())]

    @property
    def fault(self) -> str:
        """Why TF does not say where the root is at the moment, "" where it does or is not asked."""
        return self._root.fault

    def close(self) -> None:
        """Stop listening."""
        self._root.still()  # what is native in it must not outlive the interpreter
        for subscription in self._subscriptions:
            subscription.close()
        if self._follows_tf:
            self._transforms.leave(self._on_transforms)
        if self._broadcaster is not None:
            self._broadcaster.close()

    def _on_effective_gravity(self, message: Vector3Stamped) -> None:
        vector = np.array(vector_of(message.vector))
        if not np.linalg.norm(vector) <= LARGEST_EFFECTIVE_GRAVITY * STANDARD_GRAVITY:
            allowed = f"(3,), finite, up to {LARGEST_EFFECTIVE_GRAVITY * STANDARD_GRAVITY:.1f} m/s2 long"
            raise ValueError(f"effective_gravity must be {allowed}, got {vector.tolist()}")
        self._received_until = monotonic_ns() + FRESH
        self._on_motion(EffectiveGravity(vector), stamp_of(message))

    def _on_pose(self, message: PoseStamped) -> None:
        new = self._root.follows(stamp_of(message))
        self._root.pose(message)
        if new:
            self._broadcast(message.header, message.pose)

    def _on_odometry(self, message: Odometry) -> None:
        new = self._root.follows(stamp_of(message))
        self._root.odometry(message)
        if new:
            self._broadcast(message.header, message.pose.pose)

    def _broadcast(self, header, pose) -> None:
        if self._broadcaster is not None:
            self._broadcaster.publish(header, vector_of(pose.position), quaternion_of(pose.orientation))

    def _on_transforms(self, wrong: Mapping[str, str]) -> None:
        tree = self._transforms.tree
        if tree.left_out != self._left_out:  # once, the first
            self._left_out = tree.left_out
            self._on_bad(f"frames of TF are left out: {tree.left_out}")
        for reason in self._root.transforms(tree, wrong, *self._frames):
            self._on_bad(reason)

    def _move(self, motion: RootSample | EffectiveGravity, stamp_ns: int) -> None:
        if monotonic_ns() > self._received_until:
            self._on_motion(motion, stamp_ns)

    def _listen(self, kind: type, topic: str, take: Callable[..., None]) -> None:
        def on_message(message) -> None:
            try:
                take(message)
            except ValueError as error:
                self._on_bad(str(error))

        self._subscriptions.append(FollowingSubscription(self._node, kind, topic, on_message))
