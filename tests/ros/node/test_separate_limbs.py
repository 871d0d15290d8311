"""A drape node that separates limbs: what it drapes, what it tells those who draw the body, what it counts."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from sensor_msgs.msg import JointState  # noqa: E402

from physkin_core import LimbSeparator  # noqa: E402


@pytest.fixture(scope="module")
def separating_node(running_node, model_path):
    with running_node({"model": str(model_path), "separate_limbs": True}) as node:
        yield node


@pytest.fixture
def told(peer, separating_node):
    """Stamp -> joint states that the node publishes."""
    states = {}

    def on_state(message):
        states[message.header.stamp.sec, message.header.stamp.nanosec] = message

    subscription = peer.node.create_subscription(JointState, "drape_node/joint_states", on_state, 10)
    peer.until(subscription.get_publisher_count, "topic of separated joint states")
    peer.spin(0.2)
    yield states
    peer.node.destroy_subscription(subscription)


@pytest.fixture(scope="module")
def separator(draper):
    return LimbSeparator(draper.model.rig, draper.avatar)


def test_separated_positions_are_draped_published_and_counted(peer, told, draper, separator):
    """Once a joint state; the cloud is of them, the message names the rig's joints and has the stamp and frame."""
    rig = draper.model.rig
    folded = {"upperarm01.L_x": -0.7, "upperarm01.R_x": 0.7, "lowerarm01.L_z": -1.2, "upperarm01.L_z": -1.0}
    given = rig.joint_positions(folded).astype(np.float32)
    expected, change = separator.separate(given)
    assert change > 0.01
    cloud = peer.cloud(rig.joint_names, given, (5, 6))
    peer.until(lambda: (5, 6) in told, "separated joint state")
    state = told[5, 6]
    assert tuple(state.name) == rig.joint_names and state.header.frame_id == "base_link"
    np.testing.assert_array_equal(np.float32(state.position), expected)
    np.testing.assert_array_equal(cloud, draper.drape(expected))
    peer.until_told("joint states with limbs separated", "1")
    assert float(peer.latest("largest separation [rad]")) == pytest.approx(change, abs=1e-3)


def test_missing_joints_keep_what_came_in(peer, told, draper, separator):
    """What was separated does not become the last position: the next message moves on from what was sent."""
    rig = draper.model.rig
    given = rig.joint_positions({"upperarm01.L_x": -0.7, "upperarm01.R_x": 0.7}).astype(np.float32)
    peer.cloud(rig.joint_names, given, (6, 0))
    given[rig.joint_names.index("head_z")] = 0.1
    np.testing.assert_array_equal(
        peer.cloud(["head_z"], [0.1], (6, 500_000_000)), draper.drape(separator.separate(given)[0])
    )


def test_no_topic_without_the_parameter(peer, running_node, model_path, separating_node):
    """It is off unless asked for; each avatar has its own."""
    overrides = {
        "avatars.alice.separate_limbs": True,
        "avatars.alice.garments.top.model": str(model_path),
        "avatars.bob.garments.top.model": str(model_path),
    }
    with running_node(overrides, connect=False) as node:
        published = dict(node.get_publisher_names_and_types_by_node("drape_node", "/"))
        assert "/drape_node/alice/joint_states" in published and "/drape_node/bob/joint_states" not in published
