"""Quality of service: how streams are published, and subscriptions that take what the publishers there are offer."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message

__all__ = ["FollowingSubscription", "stream_quality"]

QUEUE = 200
"""Messages that may wait while the machine is busy, a second at 200 Hz; they are worked off in a tenth of that."""

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
OVERRIDABLE = ("HISTORY", "DEPTH", "RELIABILITY", "DURABILITY", "DEADLINE", "LIVELINESS", "LIVELINESS_LEASE_DURATION")
REMEMBERED = 512
"""Messages that are known again when the other subscription brings them: one comes milliseconds after the other."""


def stream_quality(depth: int = 5, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> dict[str, object]:
    """Arguments of a stream's publisher or subscription: reliable, keep last, open to `qos_overrides` parameters."""
    overrides = QoSOverridingOptions(policy_kinds=[QoSPolicyKind[policy] for policy in OVERRIDABLE])
    return {"qos_profile": QoSProfile(depth=depth, durability=durability), "qos_overriding_options": overrides}


class FollowingSubscription:
    """A reliable subscription, and a second one that is best effort while a publisher offers no more than that.

    So reliable publishers lose nothing while others come and go; what both subscriptions bring is taken once. A
    parameter `qos_overrides./TOPIC.subscription.reliability` ends that: there is one subscription, as it says.
    callback: takes a message, its bytes where `raw`. topic: its full name. latched: take what publishers have kept of
    before, too; those that keep nothing are not heard then. on_lost: called with the number of messages that the
    middleware has lost, where it can tell.
    """

    def __init__(
        self,
        node,
        kind: type,
        topic: str,
        callback: Callable,
        *,
        raw: bool = False,
        latched: bool = False,
        on_lost: Callable[[int], None] = lambda number: None,
    ) -> None:
        self._node, self._kind = node, kind
        self._durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        self._callback = callback if raw else lambda data: callback(deserialize_message(data, kind))
        self._ahead: OrderedDict[int, int] = OrderedDict()
        self._best_effort = None
        lost = self._lost = {"message_lost": lambda event: on_lost(event.total_count_change)}
        events = SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible, **lost)
        quality = stream_quality(QUEUE, self._durability)
        self._first = node.create_subscription(kind, topic, self._on_first, raw=True, event_callbacks=events, **quality)

    @property
    def topic(self) -> str:
        """See the class."""
        return self._first.topic_name

    def follow(self) -> str:
        """Look at who publishes, and subscribe as that asks for. Returns what is offered: "reliable", "best effort",
        "reliable and best effort", or "" where nobody publishes."""
        kind = f"{self._kind.__module__.split('.')[0]}/msg/{self._kind.__name__}"
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        offered = {each.qos_profile.reliability for each in publishers if each.topic_type == kind}
        if BEST_EFFORT in offered:
            self._open_best_effort()
        else:
            self._close_best_effort()
        names = {RELIABLE: "reliable", BEST_EFFORT: "best effort"}
        return " and ".join(name for policy, name in names.items() if policy in offered)

    def close(self) -> None:
        """Take no more."""
        self._close_best_effort()
        self._node.destroy_subscription(self._first)

    @property
    def _is_chosen(self) -> bool:
        return f"qos_overrides.{self.topic}.subscription.reliability" in self._node._parameter_overrides

    def _on_incompatible(self, event) -> None:
        if event.last_policy_kind == QoSPolicyKind.RELIABILITY and not self._is_chosen:
            self._open_best_effort()  # at once: the graph may not know the publisher yet
            return
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        self._node.get_logger().warning(
            f"{self.topic}: nothing will come from a publisher whose {policy} is incompatible with what is requested"
        )

    def _open_best_effort(self) -> None:
        if self._best_effort is not None or self._is_chosen:
            return
        quality = QoSProfile(depth=QUEUE, reliability=BEST_EFFORT, durability=self._durability)
        events = SubscriptionEventCallbacks(**self._lost)
        self._best_effort = self._node.create_subscription(
            self._kind, self.topic, self._on_best_effort, quality, raw=True, event_callbacks=events
        )
        self._node.get_logger().info(
            f"{self.topic}: subscribed best effort, too, as a publisher offers no more; what is lost of that is not "
            "sent again"
        )

    def _close_best_effort(self) -> None:
        if self._best_effort is not None:
            self._node.destroy_subscription(self._best_effort)
            self._best_effort = None
            self._ahead.clear()

    def _on_first(self, data: bytes) -> None:
        if self._best_effort is None or self._is_new(data, 1):
            self._callback(data)

    def _on_best_effort(self, data: bytes) -> None:
        if self._is_new(data, -1):
            self._callback(data)

    def _is_new(self, data: bytes, side: int) -> bool:
        """Whether the other subscription has not brought it. side: 1 for the first, -1 for the best-effort one."""
        key = hash(data)
        ahead = self._ahead.pop(key, 0)
        if ahead + side:
            self._ahead[key] = ahead + side
        if len(self._ahead) > REMEMBERED:
            self._ahead.popitem(last=False)
        return ahead * side >= 0
