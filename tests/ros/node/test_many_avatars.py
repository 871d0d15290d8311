"""A drape node with several avatars and garments as a process: streams, discovery, swaps and transitions."""

from __future__ import annotations

import time

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from nav_msgs.msg import Odometry  # noqa: E402
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

from drape_site import text_parameter  # noqa: E402
from physkin_msgs.srv import SetBody, SetGarment  # noqa: E402

TOP, BOB = "alice/top", "bob/top"


@pytest.fixture(scope="module")
def drapers(garment_model, leaning_model_path):
    avatar = load_avatar(BUNDLED_AVATAR, garment_model.rig)
    leaning_model = load_garment_model(leaning_model_path)
    return {TOP: Draper(garment_model, avatar), BOB: Draper(leaning_model, avatar)}


def test_each_avatar_has_its_stream(site, drapers, garment_model):
    """A joint state is answered by a cloud of its avatar and of no other, equal to the core's."""
    rig = garment_model.rig
    pose = np.random.default_rng(1).uniform(rig.lower, rig.upper).astype(np.float32)
    np.testing.assert_array_equal(site.cloud(TOP, rig.joint_names, pose), drapers[TOP].drape(pose))
    assert site.clouds[TOP, (site.stamp, 0)][1] == "alice" and (BOB, (site.stamp, 0)) not in site.clouds


def test_gravity_by_odometry(site, drapers, garment_model):
    """The root's orientation tilts gravity; bad poses change nothing."""
    rig = garment_model.rig
    odometry = Odometry()
    turn = odometry.pose.pose.orientation
    turn.x, turn.y, turn.z, turn.w = 0.0, 0.6, 0.0, 0.8
    publisher = site.publisher("/bob/odometry", Odometry)
    publisher.publish(odometry)
    site.spin(0.2)
    rest = rig.rest.astype(np.float32)
    cloud = site.cloud(BOB, rig.joint_names, rest)
    np.testing.assert_allclose(cloud, drapers[BOB].drape(rest, np.array([0.96, 0, -0.28])), atol=1e-5)
    assert site.clouds[BOB, (site.stamp, 0)][1] == "bobs_root"
    turn.w = 7.0
    publisher.publish(odometry)
    site.until(lambda: "unit quaternion" in site.statuses.get(BOB, {}).get("last rejection", ""), "diagnostics")
    np.testing.assert_array_equal(site.cloud(BOB, rig.joint_names[3:4], rest[3:4]), cloud)


def test_bodies_come_and_go(site, drapers, garment_model):
    """A ROS4HRI body is dressed when its topic appears, only so many at a time, and taken down when it goes."""
    site.listen("zoe/top")
    topic = "/humans/bodies/zoe/joint_states"
    publisher = site.node.create_publisher(JointState, topic, 10)
    site._publishers[topic] = publisher
    site.until(publisher.get_subscription_count, "subscription to the body")
    site.until(lambda: "zoe/top" in site.meshes, "mesh of the body")
    rig = garment_model.rig
    expected = rig.rest.astype(np.float32)
    expected[rig.joint_names.index("neck01_z")] = 0.1
    cloud = site.cloud("zoe/top", ["neck01_z"], [0.1], topic=topic)
    np.testing.assert_array_equal(cloud, drapers[TOP].drape(expected))
    assert site.clouds["zoe/top", (site.stamp, 0)][1] == "body_zoe"
    others = [
        site.node.create_publisher(JointState, f"/humans/bodies/{body}/joint_states", 10) for body in ("dan", "eve")
    ]
    site.until(lambda: others[0].get_subscription_count(), "the second body")
    site.spin(1.5)
    assert others[1].get_subscription_count() == 0
    assert "1 bodies wait: parameter max_bodies is 2" in site.log.read_text()
    site.node.destroy_publisher(publisher)
    site.until(others[1].get_subscription_count, "the third body, once the first has gone")
    assert "zoe: the body is gone" in site.log.read_text()
    for other in others:
        site.node.destroy_publisher(other)
    site.until(lambda: not site.node.count_subscribers("/humans/bodies/eve/joint_states"), "end of the bodies")


def test_body_swap_loses_no_cloud(site, drapers, garment_model, other_body):
    """While the body is swapped every joint state is answered: by the old body, then the new one, never a mixture."""
    rig = garment_model.rig
    rest = rig.rest.astype(np.float32)
    avatar = load_avatar(other_body, rig)
    expected = {False: drapers[TOP].drape(rest).copy(), True: Draper(garment_model, avatar).drape(rest)}
    assert np.abs(expected[True] - expected[False]).max() > 0.01
    site.until(lambda: TOP in site.meshes, "mesh")
    before, revision = site.stamp + 1, site.meshes[TOP].revision
    publisher = site.publisher("/alice/joint_states")
    client = site.node.create_client(SetBody, "/drape_node/set_body")
    site.until(client.service_is_ready, "service")
    future = client.call_async(SetBody.Request(avatar="alice", body_mesh=str(other_body)))
    after_done = 0
    while after_done < 30:
        publisher.publish(site.state(rig.joint_names, rest))
        end = time.monotonic() + 0.005
        while time.monotonic() < end:
            site.executor.spin_once(timeout_sec=0.001)
        after_done += future.done()
    answer = future.result()
    assert answer.success and answer.seconds > 0, answer.message
    stamps = [(stamp, 0) for stamp in range(before, site.stamp + 1)]
    site.until(lambda: all((TOP, stamp) in site.clouds for stamp in stamps), "clouds during the swap")
    worn = []
    for stamp in stamps:
        equal = [np.array_equal(site.clouds[TOP, stamp][0], expected[new]) for new in (False, True)]
        assert sum(equal) == 1
        worn.append(equal[1])
    assert worn == sorted(worn) and not worn[0] and worn[-1]
    assert site.meshes[TOP].revision == revision + 1  # the rest shape follows the body

    assert site.call(SetBody, "set_body", avatar="alice").success
    np.testing.assert_array_equal(site.cloud(TOP, rig.joint_names, rest), expected[False])
    answer = site.call(SetBody, "set_body", avatar="alice", body_mesh=str(other_body))
    assert answer.success and answer.cached
    assert site.call(SetBody, "set_body", avatar="alice").success
    values = site.call(GetParameters, "get_parameters", names=["avatars.alice.body_mesh"]).values
    assert values[0].string_value == ""


def test_garment_swap(site, drapers, garment_model, leaning_model_path, model_path):
    """The mesh of the other garment is published with the next revision, and its clouds follow; it may be of another
    fabric, too."""
    rig = garment_model.rig
    site.until(lambda: TOP in site.meshes, "mesh")
    revision = site.meshes[TOP].revision
    answer = site.call(SetGarment, "set_garment", avatar="alice", garment="top", model="tshirt")
    assert answer.success, answer.message
    site.until(lambda: site.meshes[TOP].revision == revision + 1, "mesh of the other garment")
    assert site.meshes[TOP].model_name == "tshirt"
    assert len(site.cloud(TOP, rig.joint_names, rig.rest)) == site.meshes[TOP].vertex_count
    answer = site.call(SetGarment, "set_garment", avatar="alice", garment="top", model="tshirt:denim")
    assert answer.success, answer.message  # of another fabric
    values = site.call(GetParameters, "get_parameters", names=["avatars.alice.garments.top.model"]).values
    assert values[0].string_value == "tshirt:denim"
    request = [text_parameter("avatars.alice.garments.top.model", str(model_path))]  # back, by the parameter
    (result,) = site.call(SetParameters, "set_parameters", parameters=request).results
    assert result.successful
    site.until(lambda: site.meshes[TOP].model_name == "vest", "the first garment again")
    rest = rig.rest.astype(np.float32)
    np.testing.assert_array_equal(site.cloud(TOP, rig.joint_names, rest), drapers[TOP].drape(rest))


def test_swaps_that_fail_leave_the_old(site, drapers, garment_model, other_body, tmp_path):
    """Each says why; clouds go on as before, and the diagnostics tell of the last."""
    (tmp_path / "outside.obj").write_bytes(other_body.read_bytes())
    (other_body.parent / "link.obj").symlink_to(tmp_path / "outside.obj")
    worn = {"avatar": "alice", "garment": "top"}
    for kind, request, reason in (
        (SetBody, {"avatar": "alice", "body_mesh": str(other_body.parent / "link.obj")}, "outside the parameter"),
        (SetBody, {"avatar": "alice", "body_mesh": str(other_body.parent)}, "no such file"),
        (SetBody, {"avatar": "carol"}, "no avatar 'carol'; allowed: 'alice', 'bob'"),
        (SetGarment, {"avatar": "ann", "model": "tshirt"}, "no garment ''; allowed: '"),
        (SetGarment, worn, "model must not be empty"),
        (SetGarment, worn | {"model": "nosuch"}, "'nosuch'"),
        (SetGarment, worn | {"model": "tshirt:velvet"}, "unknown fabric 'velvet'; allowed: jersey"),
        (
            SetGarment,
            worn | {"model": "tshirt:density=9"},
            "density 9 kg/m2 at stretch 200 N/m is not what 'tshirt' has",
        ),
        (SetGarment, worn | {"model": str(tmp_path / "x.safetensors")}, "outside the parameter"),
        (SetGarment, worn | {"model": str(other_body)}, "is not a garment model"),
    ):
        answer = site.call(kind, "set_body" if kind is SetBody else "set_garment", **request)
        assert not answer.success and reason in answer.message, (request, answer.message)
    rest = garment_model.rig.rest.astype(np.float32)
    np.testing.assert_array_equal(site.cloud(TOP, garment_model.rig.joint_names, rest), drapers[TOP].drape(rest))
    site.until(lambda: "is not a garment model" in site.statuses[TOP]["last error"], "diagnostics")


def test_parameters_are_validated(site, other_body):
    """Each change is refused with a reason; a body that cannot be read is worn no more than by the service."""
    (other_body.parent / "empty.obj").write_bytes(b"")
    for name, value, reason in (
        ("avatars.alice.body_mesh", "/etc/passwd", "outside the parameter asset_roots"),
        ("avatars.alice.garments.top.model", "", "must not be empty"),
        ("avatars.alice.garments.top.model", "tshirt:velvet", "unknown fabric 'velvet'; allowed: jersey"),
        ("avatars.alice.frame_id", "torso", "read-only"),
        ("avatars.alice.sway", "much", "parameter avatars.alice.sway is 'much'; allowed: a number from 0 to 1"),
    ):
        (result,) = site.call(SetParameters, "set_parameters", parameters=[text_parameter(name, value)]).results
        assert not result.successful and reason in result.reason.replace("read only", "read-only"), result.reason
    name = "avatars.alice.body_mesh"
    parameters = [text_parameter(name, str(other_body.parent / "empty.obj"))]
    (result,) = site.call(SetParameters, "set_parameters", parameters=parameters).results
    assert result.successful
    value = lambda: site.call(GetParameters, "get_parameters", names=[name]).values[0].string_value  # noqa: E731
    site.until(lambda: value() == "", "parameter to go back")
    names = ["avatars.alice.joint_map", "avatars.alice.sway", "max_bodies", "avatars.bob.orientation"]
    described = site.call(DescribeParameters, "describe_parameters", names=names).descriptors
    assert all(each.description for each in described)
    assert [each.read_only for each in described] == [True, False, True, True]
    assert described[1].floating_point_range[0].to_value == 1 and described[2].integer_range[0].from_value == 1
    assert "odometry" in described[3].additional_constraints


def test_statistics(site, garment_model):
    """Numbers for each garment, once a second."""
    site.statistics.clear()
    rig = garment_model.rig
    for _ in range(20):
        site.cloud(BOB, rig.joint_names, rig.rest)
    site.until(lambda: len(site.statistics) >= 2, "statistics")
    entries = {(entry.avatar, entry.garment): entry for entry in site.statistics[-1].garments}
    assert {("alice", "top"), ("ann", "zlegs"), ("bob", "top")} <= entries.keys()
    assert entries["bob", "top"].published >= 20 and entries["bob", "top"].model_name == "vest"
    rates = [entry.published_rate for message in site.statistics for entry in message.garments if entry.avatar == "bob"]
    assert max(rates) > 1
