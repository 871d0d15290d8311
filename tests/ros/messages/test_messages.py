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


def test_mesh_and_garment_nodes(start, peer, garment_model, model_path):
    """The mesh reaches a reader that comes late; garment nodes come with the stamp of their cloud, and skin to it."""
    from physkin_ros.client import GarmentClient

    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))
    start("physkin_ros", "--ros-args", "-p", f"model:={model_path}")
    peer.connect()
    meshes, frames, skinned = [], [], []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(messages.GarmentMesh, "drape_node/mesh", meshes.append, latched)
    peer.node.create_subscription(messages.GarmentNodes, "drape_node/garment_nodes", frames.append, 10)
    client = GarmentClient(peer.node, lambda frame: skinned.append((frame.header, frame.points.copy(), frame.faces)))
    peer.until(lambda: meshes, "mesh")
    peer.spin(0.5)

    (mesh,) = meshes
    garment, rig = garment_model.garment, garment_model.rig
    assert (mesh.model_name, mesh.avatar, mesh.revision, mesh.header.frame_id) == ("vest", "", 1, "base_link")
    assert (mesh.vertex_count, mesh.node_count) == (len(garment.vertices), len(garment_model.node_rest))
    assert tuple(mesh.joint_names) == rig.joint_names
    np.testing.assert_array_equal(np.reshape(mesh.faces, (-1, 3)), garment.faces)
    np.testing.assert_allclose(np.reshape(mesh.rest_vertices, (-1, 3)), draper.rest_garment.vertices, atol=1e-6)
    np.testing.assert_allclose(mesh.joint_rest, rig.rest, atol=1e-6)

    positions = np.full(len(rig.joint_names), 0.05, dtype=np.float32)
    cloud = peer.cloud(rig.joint_names, positions, (5, 6))
    peer.until(lambda: frames and skinned, "garment nodes")
    assert (frames[0].header.stamp.sec, frames[0].header.stamp.nanosec) == (5, 6) and frames[0].revision == 1
    draper.drape(positions)
    np.testing.assert_allclose(np.reshape(frames[0].transforms, (-1, 3, 4)), draper.node_transforms(), atol=1e-6)
    header, points, faces = skinned[0]
    assert (header.stamp.sec, header.frame_id, client.skipped) == (5, "base_link", 0)
    np.testing.assert_array_equal(points, cloud)
    np.testing.assert_array_equal(faces, garment.faces)


def test_skin_refuses_what_does_not_fit(garment_model):
    """Meshes that contradict themselves, and garment nodes of another garment, say why."""
    from physkin_ros.client import GarmentSkin
    from physkin_ros.messages.conversions import garment_mesh

    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))
    mesh = garment_mesh(draper.outfit, 0, "torso", revision=3)
    skin = GarmentSkin(mesh)
    count = 12 * len(garment_model.node_rest)
    for nodes, reason in (
        (messages.GarmentNodes(revision=2, transforms=[0.0] * count), "of revision 2, the mesh has revision 3"),
        (messages.GarmentNodes(revision=3, transforms=[0.0] * 24), "24 numbers for 16 garment nodes"),
        (messages.GarmentNodes(revision=3, transforms=[float("nan")] * count), "not finite"),
    ):
        with pytest.raises(ValueError, match=reason):
            skin.skin(nodes)
    for field, value, reason in (
        ("vertex_count", 7, "5010 vertices and 16 garment nodes"),
        ("faces", [0, 1, 10**6], "face index 1000000"),
        ("influence_nodes", [99] * len(mesh.influence_nodes), "99"),
    ):
        wrong = garment_mesh(draper.outfit, 0, "torso")
        setattr(wrong, field, value)
        with pytest.raises(ValueError, match=f"garment mesh 'vest'.*{reason}"):
            GarmentSkin(wrong)
