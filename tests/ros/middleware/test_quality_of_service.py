"""Whatever quality of service publishers offer, their messages come, each once."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

import rclpy  # noqa: E402
from geometry_msgs.msg import TransformStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402

from physkin_ros.middleware.quality_of_service import FollowingSubscription  # noqa: E402

OFFERS = {"reliable": ReliabilityPolicy.RELIABLE, "best effort": ReliabilityPolicy.BEST_EFFORT}


@pytest.fixture
def subscribed(module_peer):
    """Makes a following subscription in a ROS node of its own: that, and the seconds of the stamps that have come."""

    @contextmanager
    def subscribe(kind=JointState, parameters=(), raw=False):
        node = rclpy.create_node("follower", context=module_peer.context, parameter_overrides=list(parameters))
        module_peer.executor.add_node(node)
        came = []
        subscription = FollowingSubscription(node, kind, "followed", came.append, raw=raw)
        try:
            yield subscription, came
        finally:
            subscription.close()
            module_peer.executor.remove_node(node)
            node.destroy_node()

    return subscribe


@contextmanager
def publishing(peer, offer: str, kind=JointState, topic: str = "followed"):
    """A publisher, and what sends a message with a stamp [s]."""
    publisher = peer.node.create_publisher(kind, topic, QoSProfile(depth=100, reliability=OFFERS[offer]))

    def send(sec: int) -> None:
        message = kind()
        message.header.stamp.sec = sec
        publisher.publish(message)

    try:
        yield publisher, send
    finally:
        peer.node.destroy_publisher(publisher)


def test_joint_states_wait_while_the_node_is_busy(peer, running_node, model_path, draper):
    """A second at 200 Hz."""
    stamps, state = range(1, 201), JointState(name=list(draper.joint_names), position=draper.model.rig.rest.tolist())
    with running_node({"model": str(model_path)}):
        publisher = peer.node.create_publisher(JointState, "joint_states", len(stamps))
        try:
            peer.until(publisher.get_subscription_count, "subscription")
            for sec in stamps:
                state.header.stamp.sec = sec
                publisher.publish(state)
            peer.until(lambda: (stamps[-1], 0) in peer.clouds, "last cloud")
            assert sorted(peer.clouds) == [(sec, 0) for sec in stamps]
        finally:
            peer.node.destroy_publisher(publisher)


@pytest.mark.parametrize("raw", [False, True])
def test_publishers_come_and_go(module_peer, subscribed, raw):
    """Reliable, then best effort beside it, then that alone: all is received once, and what is offered is told."""
    peer = module_peer

    def received(count: int, came: list) -> None:
        peer.until(lambda: len(came) >= count, f"{count} messages; has {len(came)}")
        peer.spin(0.1)
        assert len(came) == count

    with subscribed(raw=raw) as (subscription, came):
        assert subscription.follow() == ""
        with publishing(peer, "reliable") as (first, send):
            peer.until(first.get_subscription_count, "subscription")
            for sec in range(10):
                send(sec)
            received(10, came)
            assert subscription.follow() == "reliable"
            with publishing(peer, "best effort") as (second, send_too):
                for sec in range(10, 40):  # nothing of this is lost while the other one comes
                    send(sec)
                    peer.spin(0.02)
                peer.until(second.get_subscription_count, "best-effort subscription")
                peer.until(lambda: first.get_subscription_count() == 2, "discovery")
                received(40, came)
                for sec in range(40, 60):
                    send(sec)
                    send_too(100 + sec)
                received(80, came)
                assert subscription.follow() == "reliable and best effort"
        with publishing(peer, "best effort") as (second, send):
            peer.until(lambda: subscription.follow() == "best effort" and second.get_subscription_count(), "change")
            send(200)
            received(81, came)
        with publishing(peer, "reliable") as (first, _):
            peer.until(lambda: subscription.follow() == "reliable", "the first offer again")
            peer.until(lambda: first.get_subscription_count() == 1, "one subscription")


def test_an_override_decides(module_peer, subscribed):
    """Whoever sets the reliability has one subscription, with that."""
    name = "qos_overrides./followed.subscription.reliability"
    for chosen in ("reliable", "best_effort"):
        with subscribed(parameters=[Parameter(name, value=chosen)]) as (subscription, _):
            with publishing(module_peer, "best effort") as (publisher, _):
                module_peer.until(lambda each=subscription: each.follow() == "best effort", "publisher")
                module_peer.spin(0.2)
                assert publisher.get_subscription_count() == (chosen == "best_effort")


def test_best_effort_joint_states_are_draped(peer, running_node, model_path, draper):
    """A node that nobody else publishes to; which quality is offered, and what the middleware says is lost, is in the
    diagnostics."""
    names, rest = list(draper.joint_names), draper.model.rig.rest.tolist()
    with running_node({"model": str(model_path)}, connect=False) as node:
        with publishing(peer, "best effort", topic="joint_states") as (publisher, _):
            peer.until(publisher.get_subscription_count, "best-effort subscription")
            for sec in range(125, 130):
                message = JointState(name=names, position=rest)
                message.header.stamp.sec = sec
                publisher.publish(message)
                peer.until(lambda sec=sec: (sec, 0) in peer.clouds, f"cloud {sec}")
            np.testing.assert_array_equal(peer.clouds[129, 0], draper.drape(np.array(rest, dtype=np.float32)))
            joint_states = node._streams[""]._subscriptions[1]
            joint_states._lost["message_lost"](SimpleNamespace(total_count_change=5))
            peer.until_told("joint states lost on the way", "5")
            peer.until_told("quality of service offered", "/joint_states reliable and best effort")  # the peer's own


def between(parent: str, child: str) -> TransformStamped:
    """A transform of one second."""
    told = TransformStamped(child_frame_id=child)
    told.header.frame_id, told.header.stamp.sec = parent, 1
    return told


def test_topics_of_tf_follow_too(peer, running_node, model_path):
    """Static transforms that were published before count, too. What is reliable: test_running_nodes.py."""
    pytest.importorskip("tf2_msgs", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")
    from tf2_msgs.msg import TFMessage

    latched = DurabilityPolicy.TRANSIENT_LOCAL
    still = peer.node.create_publisher(TFMessage, "/tf_static", QoSProfile(depth=1, durability=latched))
    still.publish(TFMessage(transforms=[between("world", "map")]))
    moving = peer.node.create_publisher(TFMessage, "/tf", QoSProfile(depth=1, reliability=OFFERS["best effort"]))
    try:
        parameters = {"model": str(model_path), "orientation": "tf", "frame_id": "root"}
        with running_node(parameters, connect=False) as node:
            peer.until(moving.get_subscription_count, "subscription")
            peer.until_told("quality of service offered", "/tf best effort")
            peer.until_told("quality of service offered", "/tf_static reliable")
            root = node._streams[""].root
            assert root.fault
            moving.publish(TFMessage(transforms=[between("map", "root")]))
            peer.until(lambda: not root.fault, "way from the root to the world")
    finally:
        peer.node.destroy_publisher(moving)
        peer.node.destroy_publisher(still)


@pytest.mark.parametrize(
    ("orientation", "kind", "offer"), [("odometry", Odometry, "best effort"), ("imu", Imu, "reliable")]
)
def test_topics_of_the_root_follow_too(peer, running_node, model_path, orientation, kind, offer):
    """Odometry that is reliable, and an IMU that is not: test_many_avatars.py and test_running_nodes.py."""
    parameters = {"model": str(model_path), "orientation": orientation}
    with running_node(parameters, connect=False):
        with publishing(peer, offer, kind, orientation) as (publisher, send):
            peer.until(publisher.get_subscription_count, "subscription")
            send(5)
            peer.until_told("quality of service offered", f"/{orientation} {offer}")
