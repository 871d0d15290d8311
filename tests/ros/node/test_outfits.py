"""A drape node whose avatars wear outfits: what it drapes, what it says of it, and how garments of it are swapped."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from rcl_interfaces.srv import GetParameters, SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

from drape_site import text_parameter  # noqa: E402
from physkin_msgs.srv import SetBody, SetGarment  # noqa: E402

from physkin_core import (  # noqa: E402
    BUNDLED_AVATAR,
    LimbSeparator,
    Outfit,
    WornGarment,
    load_avatar,
    load_garment_model,
    load_motion,
)

LEGS, TOP, BLOUSE, HOSE = "ann/zlegs", "ann/atop", "bea/top", "bea/legs"


@pytest.fixture(scope="module")
def models():
    return {name: load_garment_model(name) for name in ("trousers", "tanktop")}


@pytest.fixture(scope="module")
def avatar(models):
    return load_avatar(BUNDLED_AVATAR, models["tanktop"].rig)


@pytest.fixture(scope="module")
def outfit(models, avatar):
    """What ann wears."""
    return Outfit([models["trousers"], models["tanktop"]], avatar, precision="fp32")


@pytest.fixture(scope="module")
def motion(models):
    clip = load_motion("dance")
    return models["tanktop"].rig.joint_names, clip.positions_for(models["tanktop"].rig)[:40].astype(np.float32)


def both(site, garments, names, positions):
    """The clouds of both garments that answer one joint state."""
    first = site.cloud(garments[0], names, positions)
    key = garments[1], (site.stamp, 0)
    site.until(lambda: key in site.clouds, f"cloud {key}")
    return first, site.clouds[key][0]


def test_garments_are_worn_over_each_other(site, models, avatar, outfit, motion):
    """In the order of the file; a joint state is answered by clouds of both with its stamp, equal to the core's, frame
    after frame."""
    outfit = outfit.twin()
    names, positions = motion
    for pose in positions:
        clouds = both(site, (LEGS, TOP), names, pose)
        for cloud, expected in zip(clouds, outfit.drape(pose)):
            np.testing.assert_array_equal(cloud, expected)
    alone = Outfit([models["tanktop"]], avatar, precision="fp32").drape(positions[-1])[0]
    assert np.abs(clouds[1][:, :3] - alone[:, :3]).max() > 0.005, "the shirt must know what it is worn over"


def test_the_mesh_says_what_is_given(site, outfit):
    """Indices in the model's own mesh, faces of the points of a cloud, and once which skin is covered."""
    for k, garment in enumerate((LEGS, TOP)):
        mesh = site.meshes[garment]
        assert (mesh.layer, mesh.layers, mesh.moved) == (k, 2, k == 1)
        assert mesh.model_vertex_count == len(outfit.layers[k].model.garment.vertices)
        np.testing.assert_array_equal(mesh.visible, outfit.layers[k].visible)
        np.testing.assert_array_equal(np.reshape(mesh.faces, (-1, 3)), outfit.layers[k].faces)
        assert mesh.vertex_count == len(mesh.visible) == len(mesh.rest_vertices) // 3
    assert len(site.meshes[LEGS].visible) < site.meshes[LEGS].model_vertex_count
    np.testing.assert_array_equal(site.meshes[LEGS].body_covered, outfit.body_mask)
    assert outfit.body_mask.any() and not len(site.meshes[TOP].body_covered)
    given = site.meshes[HOSE]
    assert given.vertex_count == given.model_vertex_count == len(given.visible)
    site.until(lambda: TOP in site.statuses, "diagnostics")
    assert site.statuses[TOP]["layer"] == "2 of 2 from the skin outwards"
    legs = outfit.layers[0]
    left_out = len(legs.hidden) - legs.vertex_count
    assert 0 < left_out <= legs.hidden.sum()
    assert site.statuses[LEGS]["vertices left out"] == f"{left_out} of {len(legs.hidden)}"


def test_a_tucked_shirt_with_separated_limbs(site, models, avatar, motion):
    """With the positions separated once."""
    garments = [WornGarment(models["tanktop"], tucked=True), models["trousers"]]
    outfit = Outfit(garments, avatar, precision="fp32", hide_covered=False)
    separator = LimbSeparator(models["tanktop"].rig, avatar)
    names, rig = motion[0], models["tanktop"].rig
    folded = rig.joint_positions({"upperarm01.L_x": -0.9, "upperarm01.R_x": 0.9}).astype(np.float32)
    separated, change = separator.separate(folded)
    assert change > 0.01
    clouds = both(site, (BLOUSE, HOSE), names, folded)
    for cloud, expected in zip(clouds, outfit.drape(separated)):
        np.testing.assert_allclose(cloud, expected, atol=1e-3)
    assert site.meshes[BLOUSE].moved and not site.meshes[HOSE].moved


def test_readers_of_garment_nodes_get_the_points_before_they_are_moved(site, models, motion):
    """Of the innermost layer the cloud itself; of the outer one all but what is moved off the inner."""
    from physkin_ros.client import GarmentClient

    frames = {}
    clients = [
        GarmentClient(
            site.node,
            lambda frame, key=key: frames.__setitem__((key, frame.header.stamp.sec), frame.points.copy()),
            topics=f"/drape_node/{key}",
        )
        for key in (LEGS, TOP)
    ]
    site.until(lambda: all(client._skin is not None for client in clients), "meshes")
    site.spin(0.5)
    names, positions = motion
    legs, top = both(site, (LEGS, TOP), names, positions[20])
    site.until(lambda: {(LEGS, site.stamp), (TOP, site.stamp)} <= frames.keys(), "garment nodes")
    np.testing.assert_array_equal(frames[LEGS, site.stamp], legs)
    apart = np.linalg.norm(frames[TOP, site.stamp][:, :3] - top[:, :3], axis=1)
    assert np.median(apart) == 0 and 0 < apart.max() < 0.05
    for client in clients:
        for subscription in client._subscriptions:
            site.node.destroy_subscription(subscription)


def swap_while_joint_states_come(site, kind, name, motion, **fields):
    """Answer of the service, and the stamps of joint states sent before, during and after."""
    names, positions = motion
    client = site.node.create_client(kind, f"/drape_node/{name}")
    site.until(client.service_is_ready, "service")
    before, after, future = site.stamp + 1, 0, client.call_async(kind.Request(**fields))
    while after < 20:
        site.publisher("/ann/joint_states").publish(site.state(names, positions[site.stamp % len(positions)]))
        end = time.monotonic() + 0.01
        while time.monotonic() < end:
            site.executor.spin_once(timeout_sec=0.001)
        after += future.done()
    stamps = [(stamp, 0) for stamp in range(before, site.stamp + 1)]
    site.until(lambda: all((g, s) in site.clouds for g in (LEGS, TOP) for s in stamps), "all clouds")
    return future.result(), stamps


def test_swapping_one_garment_loses_no_cloud(site, motion):
    """Every joint state is answered for both garments, by the old outfit, then by the new one, both at once. The other
    garment's mesh is told anew where other vertices of it are hidden."""
    rest = (len(site.meshes[LEGS].visible), len(site.meshes[TOP].visible))
    revisions = site.meshes[LEGS].revision, site.meshes[TOP].revision
    request = {"avatar": "ann", "garment": "zlegs", "model": "skirt"}
    answer, stamps = swap_while_joint_states_come(site, SetGarment, "set_garment", motion, **request)
    assert answer.success and answer.seconds > 0, answer.message
    site.until(lambda: site.meshes[LEGS].revision == revisions[0] + 1, "mesh of the skirt")
    site.until(lambda: site.meshes[TOP].revision == revisions[1] + 1, "mesh of the shirt over it")
    counts = [tuple(len(site.clouds[g, s][0]) for g in (LEGS, TOP)) for s in stamps]
    other = site.meshes[LEGS].vertex_count, site.meshes[TOP].vertex_count
    assert set(counts) == {rest, other} and counts[0] == rest and counts[-1] == other
    assert counts == sorted(counts, key=lambda each: each == other)
    value = site.call(GetParameters, "get_parameters", names=["avatars.ann.garments.zlegs.model"]).values[0]
    assert value.string_value == "skirt"
    answer = site.call(SetGarment, "set_garment", **request | {"model": "trousers"})
    assert answer.success and answer.cached
    assert tuple(len(cloud) for cloud in both(site, (LEGS, TOP), motion[0], motion[1][0])) == rest


@pytest.mark.slow
def test_swapping_the_body_loses_no_cloud(site, models, motion, other_body):
    """The outfit is put on the new body as a whole."""
    request = {"avatar": "ann", "body_mesh": str(other_body)}
    answer, _ = swap_while_joint_states_come(site, SetBody, "set_body", motion, **request)
    assert answer.success, answer.message
    outfit = Outfit(
        [models["trousers"], models["tanktop"]], load_avatar(other_body, models["tanktop"].rig), precision="fp32"
    )
    names, rest = motion[0], models["tanktop"].rig.rest.astype(np.float32)
    for cloud, expected in zip(both(site, (LEGS, TOP), names, rest), outfit.drape(rest)):
        np.testing.assert_allclose(cloud[:, :3], expected[:, :3], atol=1e-3)
        np.testing.assert_allclose(cloud[:, 3:], expected[:, 3:], atol=2e-2)  # normals, of sharp folds, too
    assert site.call(SetBody, "set_body", avatar="ann").success


def test_what_cannot_be_worn_is_told_and_the_old_outfit_goes_on(site, motion):
    """By service and by parameter, in one sentence."""
    names, positions = motion
    counts = [len(site.meshes[garment].visible) for garment in (LEGS, TOP, BLOUSE, HOSE)]
    for request, reason in (
        ({"avatar": "ann", "garment": "atop", "model": "trousers"}, "garment 'trousers' is there 2 times"),
        ({"avatar": "bea", "garment": "top", "model": "dress"}, "'dress' cannot be tucked into 'trousers'"),
        ({"avatar": "bea", "garment": "legs", "model": "longsleeve"}, "'tanktop' cannot be tucked into 'longsleeve'"),
    ):
        answer = site.call(SetGarment, "set_garment", **request)
        assert not answer.success and reason in answer.message and "\n" not in answer.message, answer.message
    name = "avatars.ann.garments.atop.model"
    (result,) = site.call(SetParameters, "set_parameters", parameters=[text_parameter(name, "trousers")]).results
    assert result.successful  # read in the background
    value = lambda: site.call(GetParameters, "get_parameters", names=[name]).values[0].string_value  # noqa: E731
    site.until(lambda: value() == "tanktop", "parameter to go back")
    worn = [*both(site, (LEGS, TOP), names, positions[3]), *both(site, (BLOUSE, HOSE), names, positions[3])]
    assert [len(cloud) for cloud in worn] == counts
    site.until(lambda: "is there 2 times" in site.statuses[TOP]["last error"], "diagnostics")


def test_plain_parameters(running_node, peer, model_path, leaning_model_path, swaying_model_path):
    """`model` with a comma is an outfit, whose topics are named after its garments; swaps by the parameter."""
    vest, leaning, swaying = map(str, (model_path, leaning_model_path, swaying_model_path))
    parameters = {
        "model": f"{swaying}, {vest}",
        "asset_roots": [str(Path(each).parent) for each in (vest, leaning, swaying)],
    }
    with running_node(parameters | {"hide_covered": False}, connect=False) as node:
        topics = {name for name, _ in node.get_publisher_names_and_types_by_node("drape_node", "/")}
        assert {f"/drape_node/{Path(each).stem}/garment" for each in (swaying, vest)} <= topics
        worn = lambda: [each.model for each in node._streams[""].settings.garments]  # noqa: E731
        (result,) = node.set_parameters([Parameter("model", value=vest)])
        assert not result.successful and "names 1 garments; allowed: 2" in result.reason
        (result,) = node.set_parameters([Parameter("model", value=f"{swaying},{leaning}")])
        assert result.successful
        peer.until(lambda: worn() == [swaying, leaning], "the other garment")
        (result,) = node.set_parameters([Parameter("model", value=f"{vest},{leaning}")])
        assert result.successful, "it is only seen on the way that one garment would be worn twice"
        peer.until(lambda: node.get_parameter("model").value == f"{swaying},{leaning}", "parameter to go back")


def test_interpolated_outfits(running_node, peer, garment_model, model_path, swaying_model_path):
    """Clouds between joint states are of the whole outfit."""
    from array import array

    from sensor_msgs.msg import JointState, PointCloud2

    clouds = {"a": set(), "b": set()}
    parameters = {
        "avatars.eva.cloud_rate": 100.0,
        "avatars.eva.hide_covered": False,
        "avatars.eva.garments.a.model": str(swaying_model_path),
        "avatars.eva.garments.b.model": str(model_path),
    }
    with running_node(parameters, connect=False):
        subscriptions = [
            peer.node.create_subscription(
                PointCloud2,
                f"drape_node/eva/{name}/garment",
                lambda m, n=name: clouds[n].add((m.header.stamp.sec, m.header.stamp.nanosec)),
                100,
            )
            for name in clouds
        ]
        publisher = peer.node.create_publisher(JointState, "eva/joint_states", 10)
        peer.until(publisher.get_subscription_count, "subscription")
        peer.until(lambda: all(each.get_publisher_count() for each in subscriptions), "topics")
        peer.spin(0.3)
        rig = garment_model.rig
        for k in range(10):
            message = JointState(name=list(rig.joint_names), position=array("d", rig.rest.tolist()))
            message.header.stamp.nanosec = 50_000_000 * k
            publisher.publish(message)
            peer.spin(0.05)
        peer.until(lambda: clouds["a"] and clouds["a"] == clouds["b"], "the same clouds of both")
        assert len(clouds["a"]) > 12
        for each in (*subscriptions,):
            peer.node.destroy_subscription(each)
        peer.node.destroy_publisher(publisher)
