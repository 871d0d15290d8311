"""Our own messages, between two processes."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
messages = pytest.importorskip(
    "physkin_msgs.msg", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install"
)

from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar  # noqa: E402


def test_description_and_garment_nodes(start, peer, garment_model, model_path):
    """The description reaches a reader that comes late; garment nodes come with the stamp of their cloud."""
    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))
    start("physkin_ros", "--ros-args", "-p", f"model:={model_path}")
    peer.connect()
    descriptions, frames = [], []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(messages.GarmentDescription, "drape_node/description", descriptions.append, latched)
    peer.node.create_subscription(messages.GarmentNodes, "drape_node/nodes", frames.append, 10)
    peer.spin_until(lambda: descriptions, "description")
    peer.spin(0.5)

    (description,) = descriptions
    garment, rig = garment_model.garment, garment_model.rig
    assert (description.model_name, description.header.frame_id) == ("vest", "base_link")
    assert (description.vertex_count, description.node_count) == (len(garment.vertices), len(garment_model.node_rest))
    assert tuple(description.joint_names) == rig.joint_names
    np.testing.assert_array_equal(np.reshape(description.faces, (-1, 3)), garment.faces)
    np.testing.assert_allclose(np.reshape(description.rest_vertices, (-1, 3)), garment.vertices, atol=1e-6)
    np.testing.assert_allclose(description.joint_rest, rig.rest, atol=1e-6)

    positions = np.full(len(rig.joint_names), 0.05, dtype=np.float32)
    peer.cloud(rig.joint_names, positions, (5, 6))
    peer.spin_until(lambda: frames, "garment nodes")
    assert (frames[0].header.stamp.sec, frames[0].header.stamp.nanosec) == (5, 6)
    draper.drape(positions)
    np.testing.assert_allclose(np.reshape(frames[0].transforms, (-1, 3, 4)), draper.node_transforms(), atol=1e-6)
