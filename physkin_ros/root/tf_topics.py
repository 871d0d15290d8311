"""TF's topics."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from geometry_msgs.msg import TransformStamped

from physkin_ros.middleware.quality_of_service import FollowingSubscription
from physkin_ros.root.transform_tree import TransformTree

__all__ = ["FollowedTransforms", "TfListener"]


class TfListener:
    """Calls back with the transforms of each message, and whether they are static. Needs `tf2_msgs`.

    subscriptions: to both topics; whoever listens lets them `follow` the publishers.
    """

    def __init__(self, node, on_transforms: Callable[[Iterable[TransformStamped], bool], None]) -> None:
        from tf2_msgs.msg import TFMessage

        def take(static: bool) -> Callable[[TFMessage], None]:
            return lambda message: on_transforms(message.transforms, static)

        self.subscriptions = [
            FollowingSubscription(node, TFMessage, topic, take(static), latched=static)
            for topic, static in (("/tf", False), ("/tf_static", True))
        ]

    def close(self) -> None:
        """Stop listening."""
        for subscription in self.subscriptions:
            subscription.close()


class FollowedTransforms:
    """The frames of TF for all avatars of a ROS node that ask for them: read once, however many these are. Nothing is
    subscribed to while nobody asks."""

    def __init__(self, node) -> None:
        self.tree = TransformTree()
        self._node = node
        self._listener: TfListener | None = None
        self._followers: list[Callable[[dict[str, str]], None]] = []

    @property
    def subscriptions(self) -> list[FollowingSubscription]:
        """To the topics of TF, while somebody asks."""
        return self._listener.subscriptions if self._listener is not None else []

    def follow(self, on_change: Callable[[dict[str, str]], None]) -> None:
        """Call back after each message with what was wrong in it, as `TransformTree.update` tells."""
        if self._listener is None:
            self.tree = TransformTree()
            self._listener = TfListener(self._node, self._on_transforms)
        self._followers.append(on_change)

    def leave(self, on_change: Callable[[dict[str, str]], None]) -> None:
        """Call back no more."""
        self._followers.remove(on_change)
        if not self._followers:
            self._listener.close()
            self._listener = None

    def _on_transforms(self, transforms: Iterable[TransformStamped], static: bool) -> None:
        wrong = self.tree.update(transforms, static=static)
        for on_change in tuple(self._followers):
            on_change(wrong)
