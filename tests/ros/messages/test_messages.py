"""Our own messages, and readers that skin by them."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from random_models import random_detail

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
messages = pytest.importorskip(
    "physkin_msgs.msg", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install"
)

from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model, save_garment_model  # noqa: E402
from physkin_core.model.skinning import SkinningData  # noqa: E402
from physkin_core.runtime.evaluator import PRECISIONS  # noqa: E402
from physkin_ros.client import GarmentClient, GarmentSkin, _skinning_data  # noqa: E402
from physkin_ros.messages.conversions import NodesMessage, garment_mesh  # noqa: E402


@pytest.fixture(scope="module")
def detailed_model(garment_model):
    """The test's garment with folds of centimetres."""
    width = len(garment_model.node_deformer[-2][1])
    detail = random_detail(np.random.default_rng(37), garment_model.garment, 40, width=width)
    return replace(garment_model, name="detailed", detail=detail)


@pytest.fixture(scope="module")
def detailed(detailed_model):
    """Gives a draper of it."""
    avatar = load_avatar(BUNDLED_AVATAR, detailed_model.rig)
    return lambda **options: Draper(detailed_model, avatar, **options)


def test_mesh_and_garment_nodes(running_node, peer, detailed_model, tmp_path):
    """The mesh reaches a reader that comes late; garment nodes come with the stamp of their cloud, and skin to it, in a
    precision that is not the reader's own."""
    path = tmp_path / "detailed.safetensors"
    save_garment_model(detailed_model, path)
    read = load_garment_model(path)  # a file's skinning weights are rounded, by which the skin finds the cloth
    draper = Draper(read, load_avatar(BUNDLED_AVATAR, read.rig), precision="fp32")
    meshes, frames, skinned = [], [], []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    garment, rig = detailed_model.garment, detailed_model.rig
    positions = np.full(len(rig.joint_names), 0.05, dtype=np.float32)
    with running_node({"model": str(path), "precision": "fp32"}):
        subscriptions = [
            peer.node.create_subscription(messages.GarmentMesh, "drape_node/mesh", meshes.append, latched),
            peer.node.create_subscription(messages.GarmentNodes, "drape_node/garment_nodes", frames.append, 10),
        ]
        client = GarmentClient(
            peer.node, lambda frame: skinned.append((frame.header, frame.points.copy(), frame.faces))
        )
        peer.until(lambda: meshes and client._skin is not None, "mesh")
        peer.spin(0.5)
        cloud = peer.cloud(rig.joint_names, positions, (5, 6))
        peer.until(lambda: frames and skinned, "garment nodes")
        for subscription in (*subscriptions, *client._subscriptions):
            peer.node.destroy_subscription(subscription)

    (mesh,) = meshes
    assert (mesh.model_name, mesh.avatar, mesh.revision, mesh.header.frame_id) == ("detailed", "", 1, "base_link")
    assert (mesh.vertex_count, mesh.node_count) == (len(garment.vertices), len(detailed_model.node_rest))
    assert tuple(mesh.joint_names) == rig.joint_names
    np.testing.assert_array_equal(np.reshape(mesh.faces, (-1, 3)), garment.faces)
    np.testing.assert_allclose(np.reshape(mesh.rest_vertices, (-1, 3)), draper.rest_garment.vertices, atol=1e-6)
    np.testing.assert_allclose(mesh.joint_rest, rig.rest, atol=1e-6)
    assert (frames[0].header.stamp.sec, frames[0].header.stamp.nanosec) == (5, 6) and frames[0].revision == 1
    draper.drape(positions)
    np.testing.assert_allclose(np.reshape(frames[0].transforms, (-1, 3, 4)), draper.node_transforms(), atol=1e-6)
    header, points, faces = skinned[0]
    assert (header.stamp.sec, header.frame_id, client.skipped) == (5, "base_link", 0)
    np.testing.assert_array_equal(points, cloud)
    np.testing.assert_array_equal(faces, garment.faces)


def test_skin_refuses_what_does_not_fit(garment_model):
    """Meshes that contradict themselves, and garment nodes of another garment, say why."""
    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))
    mesh = garment_mesh(draper.outfit, 0, "torso", revision=3)
    skin = GarmentSkin(mesh)
    count = 12 * len(garment_model.node_rest)
    for nodes, reason in (
        (messages.GarmentNodes(revision=2, transforms=[0.0] * count), "of revision 2, the mesh has revision 3"),
        (messages.GarmentNodes(revision=3, transforms=[0.0] * 24), "24 numbers for 16 garment nodes"),
        (messages.GarmentNodes(revision=3, transforms=[float("nan")] * count), "not finite"),
        (
            messages.GarmentNodes(revision=3, transforms=[0.0] * count, detail_offsets=[0.0]),
            "1 numbers for 0 detail nodes",
        ),
    ):
        with pytest.raises(ValueError, match=reason):
            skin.skin(nodes)
    for field, value, reason in (
        ("vertex_count", 7, r"face index \d+ of 7 vertices"),
        ("vertex_count", 2**32 - 1, r"rest_vertices has 15030 numbers; allowed: 4294967295 \* 3"),
        ("node_count", 2**32 - 1, r"node_rest has 48 numbers; allowed: 4294967295 \* 3"),
        ("faces", [0, 1, 10**6], "face index 1000000"),
        ("influence_nodes", [99] * len(mesh.influence_nodes), "99"),
    ):
        refused(draper, field, value, reason)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_detail_travels(precision, detailed, published):
    """Readers get the clouds bit for bit, whatever precision is the node's."""
    draper = detailed(precision=precision)
    outfit, layer = draper.outfit, draper.layer
    cloud = draper.drape(np.full(len(draper.joint_names), 0.1, dtype=np.float32)).copy()
    nodes = NodesMessage(layer.bound_visible, "torso", 3)
    nodes.transforms[:], nodes.detail_offsets[:] = draper.node_transforms(), draper.detail_offsets()
    mesh = deserialize_message(serialize_message(garment_mesh(outfit, 0, "torso", revision=3)), messages.GarmentMesh)
    frame = deserialize_message(published(nodes, 5, 6), messages.GarmentNodes)
    assert (frame.header.frame_id, frame.header.stamp.sec, len(frame.detail_offsets)) == ("torso", 5, 120)
    for each in fields(SkinningData):
        np.testing.assert_array_equal(getattr(_skinning_data(mesh), each.name), getattr(layer.bound_visible, each.name))
    np.testing.assert_array_equal(GarmentSkin(mesh).skin(frame), cloud)
    frame.detail_offsets = [0.0] * 120
    assert np.linalg.norm((GarmentSkin(mesh).skin(frame) - cloud)[:, :3], axis=1).mean() > 0.01


def test_detail_that_does_not_fit_is_refused(detailed):
    """Meshes whose detail contradicts itself, and offsets that are not the mesh's or not finite."""
    draper = detailed()
    mesh = garment_mesh(draper.outfit, 0, "torso")
    count, numbers = 12 * mesh.node_count, 3 * mesh.detail_node_count
    for values, reason in (
        ([], "0 numbers for 40 detail nodes"),
        ([0.0] * 121, "121 numbers for 40 detail nodes"),
        ([np.inf] * numbers, "not finite"),
        ([1e30] * numbers, "detail_offsets"),
    ):
        with pytest.raises(ValueError, match=reason):
            GarmentSkin(mesh).skin(messages.GarmentNodes(revision=1, transforms=[0.0] * count, detail_offsets=values))
    for field, value, reason in (
        ("detail_node_count", 0, r"detail_nodes has 15030 numbers; allowed: 0 \* 3"),
        ("detail_node_count", 39, "detail_nodes.* is 39; must be in .0, 39"),
        ("detail_node_count", 2**32 - 1, "detail_node_count is 4294967295; allowed: 0 to 16777216"),
        ("detail_influences", 4, r"detail_nodes has \d+ numbers; allowed: 5010 \* 4"),
        ("detail_nodes", [40] * len(mesh.detail_nodes), "detail_nodes.*40"),
        ("detail_nodes", [2**32 - 1] * len(mesh.detail_nodes), "detail_nodes.*-1"),
        ("detail_nodes", [], r"detail_nodes has 0 numbers; allowed: 5010 \* 3"),
        ("detail_weights", mesh.detail_weights[1:], r"detail_weights has \d+ numbers; allowed: 5010 \* 3"),
        ("detail_weights", [np.nan] * len(mesh.detail_weights), "detail_weights"),
    ):
        refused(draper, field, value, reason)


def refused(draper, field, value, reason):
    """A mesh with another value in this field."""
    wrong = garment_mesh(draper.outfit, 0, "torso")
    setattr(wrong, field, value)
    with pytest.raises(ValueError, match=f"garment mesh '{draper.layer.name}': .*{reason}") as refusal:
        GarmentSkin(wrong)
    assert len(str(refusal.value)) <= 300 and str(refusal.value).isprintable()


def test_messages_of_an_earlier_version_are_told(peer, detailed):
    """As a bag that was recorded before detail plays them, whose bytes end early: a sentence each, and what comes after
    is skinned."""
    draper = detailed()
    draper.drape(np.full(len(draper.joint_names), 0.1, dtype=np.float32))
    mesh, frame = garment_mesh(draper.outfit, 0, "torso"), messages.GarmentNodes(revision=1)
    frame.transforms = draper.node_transforms().ravel().tolist()
    frame.detail_offsets = draper.detail_offsets().ravel().tolist()
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    meshes = peer.node.create_publisher(messages.GarmentMesh, "/bag/mesh", latched)
    nodes = peer.node.create_publisher(messages.GarmentNodes, "/bag/garment_nodes", 5)
    skinned, told = [], []
    client = GarmentClient(peer.node, lambda frame: skinned.append(frame.points.copy()), topics="/bag")
    client._log = SimpleNamespace(error=told.append, warning=lambda text, **_: told.append(text))
    peer.until(lambda: nodes.get_subscription_count() and meshes.get_subscription_count(), "the reader")
    for publisher, message, left_out in ((meshes, mesh, "detail_weights"), (nodes, frame, "detail_offsets")):
        setattr(message, left_out, [])
        publisher.publish(serialize_message(message)[:-12])
    peer.until(lambda: len(told) == 2, "both sentences")
    assert "no GarmentMesh as physkin_msgs has it here" in told[0] and "must have the same version" in told[0]
    assert "no GarmentNodes as physkin_msgs has it here" in told[1] and client.skipped == 1
    frame.detail_offsets = draper.detail_offsets().ravel().tolist()
    meshes.publish(garment_mesh(draper.outfit, 0, "torso"))
    peer.until(lambda: client._skin is not None, "mesh")
    nodes.publish(frame)
    peer.until(lambda: skinned, "points")
