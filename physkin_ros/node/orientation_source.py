"""The subscriptions that tell an avatar's root state where down is, and how its root moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from physkin_ros.messages.interfaces import missing_tf
from physkin_ros.messages.topics import GRAVITY, IMU, ODOMETRY
from physkin_ros.middleware.quality_of_service import FollowingSubscription
from physkin_ros.node.settings import AvatarSettings, SettingsError
from physkin_ros.root.root_state import RootState
from physkin_ros.root.tf_topics import FollowedTransforms

__all__ = ["OrientationSource", "check_orientation"]


def check_orientation(avatar: AvatarSettings) -> None:
    """Raises SettingsError for TF where `tf2_msgs` is not installed."""
    if avatar.orientation == "tf" and (missing := missing_tf()):
        raise SettingsError(f"parameter {avatar.prefix}orientation is 'tf', but {missing}")


class OrientationSource:
    """Tells `root` what messages say. transforms: TF, of all avatars. on_bad: called with why one says nothing."""

    def __init__(
        self,
        node,
        avatar: AvatarSettings,
        transforms: FollowedTransforms,
        root: RootState,
        on_bad: Callable[[str], None],
    ) -> None:
        self._transforms, self._root, self._on_bad = transforms, root, on_bad
        self._frames = avatar.frame_id, avatar.world_frame
        self._left_out = ""
        self._subscription: FollowingSubscription | None = None
        if avatar.orientation == "tf":
            transforms.follow(self._on_transforms)
            self._on_transforms({})
            return
        topic, kind, take = {
            "gravity": (GRAVITY, Vector3Stamped, root.on_direction),
            "odometry": (ODOMETRY, Odometry, root.on_odometry),
            "imu": (IMU, Imu, root.on_imu),
        }[avatar.orientation]

        def on_message(message) -> None:
            try:
                take(message)
            except ValueError as error:
                on_bad(str(error))

        self._subscription = FollowingSubscription(node, kind, topic.of(avatar.id), on_message)

    @property
    def subscriptions(self) -> list[FollowingSubscription]:
        """All that it listens to; those of TF are shared with other avatars."""
        return self._transforms.subscriptions if self._subscription is None else [self._subscription]

    def close(self) -> None:
        """Stop listening."""
        self._root.still()  # what is native in it must not outlive the interpreter
        if self._subscription is None:
            self._transforms.leave(self._on_transforms)
        else:
            self._subscription.close()

    def _on_transforms(self, wrong: Mapping[str, str]) -> None:
        tree = self._transforms.tree
        if tree.left_out != self._left_out:  # once, the first
            self._left_out = tree.left_out
            self._on_bad(f"frames of TF are left out: {tree.left_out}")
        for reason in self._root.on_transforms(tree, wrong, *self._frames):
            self._on_bad(reason)
