"""A drape node in the tests' own process: its topics, and what it makes of good and bad joint states."""

from __future__ import annotations

import math
from itertools import count

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from core.points.splat_files import splat_ply  # noqa: E402
from geometry_msgs.msg import Quaternion, Transform, Vector3, Vector3Stamped  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState, MultiDOFJointState  # noqa: E402

from physkin_ros.messages.topics import TOPICS  # noqa: E402
from physkin_ros.node.avatar_stream import MOST_UNKNOWN  # noqa: E402
from physkin_ros.node.garment_stream import LayerMessages  # noqa: E402

STAMPS = ((sec, 0) for sec in count(1000))  # one for each joint state whose stamp does not matter
OWN = (
    *("diagnostic_msgs", "geometry_msgs", "nav_msgs", "physkin_msgs"),
    *("sensor_msgs", "tf2_msgs", "visualization_msgs"),
)
"""Packages of our types; those of others (parameters, lifecycle, clock) every node of ROS has."""


@pytest.fixture(scope="module")
def shared_node(running_node, model_path):
    """A node that drapes the test's garment on the bundled avatar."""
    with running_node({"model": str(model_path)}) as node:
        yield node


def test_order_extra_and_missing_joints(peer, shared_node, draper):
    """Joints in any order; unknown ones are ignored, missing ones keep their last position, at first the rest."""
    names, rig = np.array(draper.joint_names), draper.model.rig
    random = np.random.default_rng(1)
    state = rig.rest.astype(np.float32)
    np.testing.assert_array_equal(peer.cloud(names[:1], state[:1], (1, 0)), draper.drape(state))
    state = random.uniform(rig.lower, rig.upper).astype(np.float32)
    order = random.permutation(len(names))
    cloud = peer.cloud([*names[order], "tail"], [*state[order], 9.0], (2, 0))
    np.testing.assert_array_equal(cloud, draper.drape(state))
    state[3:5] = 0.1, 0.2
    np.testing.assert_array_equal(peer.cloud(names[3:5], state[3:5], (3, 0)), draper.drape(state))


def test_stamps_are_verbatim(peer, shared_node, draper):
    """Clouds carry the joint states' stamps to the nanosecond, also ones that jump back, and the frame asked for."""
    stamps = [(0, 0), (1, 999_999_999), (2_000_000_000, 1), (7, 3)]
    for stamp in stamps:
        peer.cloud(draper.joint_names, draper.model.rig.rest, stamp)
    assert sorted(peer.clouds) == sorted(stamps)
    assert peer.frame_ids == {"base_link"}


def test_bad_joint_states_leave_the_last_good_state(peer, shared_node, draper, capfd):
    """Each is warned about and shows in the diagnostics, no cloud answers it, and the next one goes on from before."""
    names = list(draper.joint_names)
    good = np.linspace(-0.2, 0.2, len(names)).astype(np.float32)
    peer.cloud(names, good, (1, 0))
    peer.until_told("joint states rejected", "0")
    bad = [
        (names, [np.inf, *[np.nan] * (len(names) - 1)], f"{names[0]!r} is inf"),
        (["tail", "fin"], [0.0, 0.0], "'tail', 'fin'"),
    ]
    for index, (bad_names, values, reason) in enumerate(bad, start=1):
        peer.send(bad_names, values, (2, index))
        peer.until_told("joint states rejected", str(index))
        assert reason in peer.latest("last rejection")
    assert "joint state ignored: the position of joint" in capfd.readouterr().err
    assert list(peer.clouds) == [(1, 0)]
    good[2] = 0.15
    np.testing.assert_array_equal(peer.cloud(names[2:3], good[2:3], (3, 0)), draper.drape(good))


def test_a_joint_that_is_not_finite_stays_alone(peer, shared_node, draper, capfd):
    """The others are draped, and it is counted and named; joint states without positions are no trouble."""
    names = list(draper.joint_names)
    good = np.linspace(-0.2, 0.2, len(names)).astype(np.float32)
    peer.cloud(names, good, (1, 0))
    peer.until(lambda: peer.reports, "diagnostics")
    counts = [int(peer.latest(f"joint states {what}")) for what in ("rejected", "with positions that are not finite")]
    for stamp in ((2, 0), (3, 0)):
        moved = good + np.float32(0.01 * stamp[0])
        moved[1] = np.nan
        peer.send(names, [], (stamp[0], 5))
        cloud = peer.cloud(names, moved, stamp)
        moved[1] = good[1]
        np.testing.assert_array_equal(cloud, draper.drape(moved))
    peer.until_told("joint states with positions that are not finite", str(counts[1] + 2))
    peer.until_told("joint states without positions", "2")
    assert peer.latest("joint states rejected") == str(counts[0])
    assert f"positions of {names[1]!r} are not finite; these joints keep theirs" in capfd.readouterr().err


def test_diagnostics(peer, shared_node, draper):
    """What a person who looks for a fault needs."""
    peer.until(lambda: peer.reports, "diagnostics")
    before = int(peer.latest("clouds published"))
    for _ in range(5):
        peer.cloud(draper.joint_names, draper.model.rig.rest, next(STAMPS))
    peer.until_told("clouds published", str(before + 5))
    report = next(report for report in peer.reports if report["evaluation p50 [us]"] != "none")
    assert 0 < float(report["evaluation p50 [us]"]) <= float(report["evaluation p99 [us]"])
    assert (report["model"], report["precision"]) == ("vest", "int8")
    assert report["instruction set"] in ("baseline", "v3", "v3_vnni", "v4", "v4_vnni")
    assert float(report["last stamp age [s]"]) > 0
    assert report["cloth inside the body at rest [%]"] == f"{draper.at_rest.inside_percent:.1f}"
    assert report["advice"] == (draper.at_rest.advice or "none")


def test_degrees_are_told(peer, shared_node, draper, capfd):
    """A position of 97 is draped as it is, but warned about by name and counted."""
    names, state = draper.joint_names, draper.model.rig.rest.astype(np.float32)
    state[4] = 97.0
    np.testing.assert_array_equal(peer.cloud(names, state, next(STAMPS)), draper.drape(state))
    peer.until_told("joint states that look like degrees", "1")
    assert any(f"{names[4]!r} is 97 rad" in report["summary"] for report in peer.reports)
    assert f"{names[4]!r} is 97 rad" in capfd.readouterr().err
    peer.cloud(names, draper.model.rig.rest, next(STAMPS))


def test_changing_unknown_joints_do_not_flood_the_log(peer, shared_node, draper, capfd):
    """Some are named, with a joint that was perhaps meant; the log is bounded whatever comes."""
    name = draper.joint_names[0]
    for index in range(3 * MOST_UNKNOWN):
        peer.cloud([name, f"{name}{index}"], [0.0, 0.0], next(STAMPS))
    lines = [line for line in capfd.readouterr().err.splitlines() if "without a counterpart" in line]
    assert 0 < len(lines) <= MOST_UNKNOWN and f"did you mean {name!r}" in lines[0]


@pytest.fixture(scope="module")
def send_rotations(shared_node, module_peer):
    """Publishes rotations by bone."""
    publisher = module_peer.node.create_publisher(MultiDOFJointState, "bone_rotations", 10)
    module_peer.until(publisher.get_subscription_count, "subscription to bone_rotations")
    module_peer.spin(0.2)

    def publish(rotations, stamp) -> None:
        turns = [Transform(rotation=Quaternion(x=x, y=y, z=z, w=w)) for x, y, z, w in rotations.values()]
        message = MultiDOFJointState(joint_names=list(rotations), transforms=turns)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        publisher.publish(message)

    return publish


def rotations_of(rig, positions):
    """Quaternion (x, y, z, w) of each bone that joint positions (d,) turn."""
    turns = {}
    for dof, axis, value in zip(rig.dofs, rig.dof_axes, np.asarray(positions, dtype=np.float64)):
        turn = Rotation.from_rotvec(axis * (value - dof.rest))
        turns[dof.bone] = turns[dof.bone] * turn if dof.bone in turns else turn
    return {bone: turn.as_quat().tolist() for bone, turn in turns.items()}


def test_bone_rotations_are_draped_as_joint_positions(peer, send_rotations, draper):
    """To the bit; joint states and bone rotations may take turns, and what one leaves out the other has set."""
    rig = draper.model.rig
    pose = np.random.default_rng(2).uniform(rig.lower, rig.upper).astype(np.float32)
    send_rotations(rotations_of(rig, pose), (1, 0))
    peer.until(lambda: (1, 0) in peer.clouds, "cloud")
    np.testing.assert_array_equal(peer.clouds[1, 0], draper.drape(pose))
    pose[0] = 0.05
    np.testing.assert_array_equal(peer.cloud(rig.joint_names[:1], pose[:1], (2, 0)), draper.drape(pose))


def test_bad_bone_rotations_leave_the_last_good_pose(peer, send_rotations, draper):
    """They are counted as rejected, with the reason."""
    rest = draper.model.rig.rest.astype(np.float32)
    peer.cloud(draper.joint_names, rest, (3, 0))
    peer.until(lambda: peer.reports, "diagnostics")
    before = int(peer.latest("joint states rejected"))
    send_rotations({"head": [0.0, 0.0, 0.0, 2.0]}, (4, 0))
    peer.until_told("joint states rejected", str(before + 1))
    assert "rotation of bone 'head'" in peer.latest("last rejection")
    assert (4, 0) not in peer.clouds
    np.testing.assert_array_equal(peer.cloud(draper.joint_names[:1], rest[:1], (5, 0)), draper.drape(rest))


def test_gravity_can_change_while_running(peer, shared_node, draper):
    """A tilted root is draped as such; a direction that is none is refused."""
    names, rest = draper.joint_names, draper.model.rig.rest
    for down in ([0.0, 0.6, -0.8], [0, 1, 0]):
        (result,) = shared_node.set_parameters([Parameter("gravity", value=down)])
        assert result.successful
        np.testing.assert_array_equal(peer.cloud(names, rest, next(STAMPS)), draper.drape(rest, np.array(down)))
    for wrong in ([0.0, 0.0, 0.0], [0, -1], [True, False, True], "down", 9.81, None):
        (result,) = shared_node.set_parameters([Parameter("gravity", value=wrong)])
        assert not result.successful and f"gravity is {wrong!r}; allowed: three finite" in result.reason
    (result,) = shared_node.set_parameters([Parameter("frame_id", value="hips")])
    assert not result.successful


def sways_of(node):
    """How much the garments of each avatar sway, by its id."""
    return {name: stream.root.frame_input.sway for name, stream in node._streams.items()}


def test_sway_can_change_while_running(shared_node):
    for sway in (0.0, 0.5, 1):
        (result,) = shared_node.set_parameters([Parameter("sway", value=sway)])
        assert result.successful and sways_of(shared_node)[""] == (sway,)
    for wrong in (-0.1, 1.5, "much"):
        (result,) = shared_node.set_parameters([Parameter("sway", value=wrong)])
        assert not result.successful and "sway" in result.reason
    assert shared_node.get_parameter("sway").value == 1 and sways_of(shared_node)[""] == (1,)


def test_wind_blows_by_parameter_and_topic(peer, shared_node, draper):
    """In the frame that faces as the root does; what cannot blow is refused and told, and the last wind stays."""
    names, rest = draper.joint_names, draper.model.rig.rest
    wind, publisher = shared_node.set_parameters, peer.node.create_publisher(Vector3Stamped, "/drape_node/wind", 10)

    def blown(velocity):
        draper.wind = velocity
        expected = draper.drape(rest)
        draper.wind = (0.0, 0.0, 0.0)
        return expected

    def send(velocity):
        publisher.publish(Vector3Stamped(vector=Vector3(**dict(zip("xyz", map(float, velocity))))))

    def cloud_is(expected):
        return np.array_equal(peer.cloud(names, rest, next(STAMPS)), expected)

    try:
        (result,) = wind([Parameter("gravity", value=[0.0, 0.0, -1.0])])
        for velocity in ([-5.0, 2.0, 0.0], [6, 0, 0]):
            (result,) = wind([Parameter("wind", value=velocity)])
            assert result.successful, result.reason
            assert cloud_is(blown(velocity))
        assert not np.array_equal(blown((6, 0, 0)), draper.drape(rest))
        for wrong in ([14.0, 0.0, 0.0], [0.0, math.nan, 0.0], [1.0, 0.0], "north", 3.0):
            (result,) = wind([Parameter("wind", value=wrong)])
            assert not result.successful and "three finite numbers" in result.reason and "13 m/s" in result.reason
        peer.until(publisher.get_subscription_count, "subscription to wind")
        send((0, -8, 1))
        peer.until(lambda: cloud_is(blown((0, -8, 1))), "cloth in the wind of the topic")
        for count, velocity in enumerate(((0, 0, 13.5), (math.inf, 0, 0)), 1):
            send(velocity)
            peer.until_told("wind messages rejected", str(count))
        assert peer.latest("last rejection") == "wind must be (3,), finite, up to 13 m/s, got [inf, 0.0, 0.0]"
        assert peer.latest("wind [m/s]") == "0.00 -8.00 1.00" and cloud_is(blown((0, -8, 1)))
    finally:
        (result,) = wind([Parameter("wind", value=[0.0, 0.0, 0.0])])
        peer.node.destroy_publisher(publisher)
    assert cloud_is(draper.drape(rest))


def test_sway_of_discovered_bodies_can_change(running_node, peer, model_path):
    """Of those that are there already, and of no other avatar."""
    guests, host = "avatars.guests.", "avatars.host."
    wanted = {guests + "discover": "ros4hri"} | {
        f"{each}garments.top.model": str(model_path) for each in (guests, host)
    }
    with running_node(wanted, connect=False) as node:
        publisher = peer.node.create_publisher(JointState, "/humans/bodies/zoe/joint_states", 10)
        peer.until(publisher.get_subscription_count, "subscription to the body")
        for prefix, sway in ((guests, 0.25), (host, 0.75)):
            (result,) = node.set_parameters([Parameter(f"{prefix}sway", value=sway)])
            assert result.successful
        assert sways_of(node) == {"zoe": (0.25,), "host": (0.75,)}
        peer.node.destroy_publisher(publisher)


def test_each_garment_may_sway_by_itself(running_node, model_path, swaying_model_path):
    """What is empty goes as its avatar's does; changes while running."""
    top, bottom = "avatars.host.garments.top.", "avatars.host.garments.bottom."
    wanted = {top + "model": str(model_path), bottom + "model": str(swaying_model_path), bottom + "sway": 0.2}
    wanted["avatars.host.hide_covered"] = False  # which takes seconds to find
    changes = {
        ("avatars.host.sway", 0.5): (0.5, 0.2),
        (top + "sway", 0.0): (0.0, 0.2),
        (bottom + "sway", ""): (0.0, 0.5),
    }
    with running_node(wanted, connect=False) as node:
        for (name, value), expected in changes.items():
            (result,) = node.set_parameters([Parameter(name, value=value)])
            assert result.successful and sways_of(node)["host"] == expected, result.reason
        (result,) = node.set_parameters([Parameter(top + "sway", value=1.5)])
        assert not result.successful and "garments.top.sway" in result.reason


def test_what_fails_in_publishing_ends_nothing(peer, shared_node, draper, monkeypatch):
    """Splats are draped then, which may come out as no numbers."""

    def fail(*_):
        raise ValueError("splats are not finite")

    names, rest = draper.joint_names, draper.model.rig.rest.astype(np.float32)
    expected = peer.cloud(names, rest, next(STAMPS))
    peer.until(lambda: peer.reports, "diagnostics")
    before = int(peer.latest("joint states rejected"))
    with monkeypatch.context() as patch:
        patch.setattr(LayerMessages, "publish", fail)
        peer.send(names, rest, next(STAMPS))
        peer.until_told("joint states rejected", str(before + 1))
    assert peer.latest("last rejection") == "splats are not finite"
    np.testing.assert_array_equal(peer.cloud(names, rest, next(STAMPS)), expected)


@pytest.mark.parametrize("orientation", ["gravity", "odometry", "imu", "tf"])
def test_every_topic_is_listed_with_its_type(orientation, running_node, model_path, garment_model, tmp_path):
    """What usage text and reference name, no more and no less, with all that parameters open."""
    pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")
    pytest.importorskip("tf2_msgs", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")
    wanted = {"model": str(model_path), "orientation": orientation, "separate_limbs": True}
    splats = tmp_path / "splats.ply"
    splats.write_bytes(splat_ply("binary_little_endian", garment_model.garment.vertices[:20]))
    wanted["splats"] = str(splats)
    with running_node(wanted, connect=False) as node:
        opened = {("out", each.topic_name, named(each.msg_type)) for each in node.publishers}
        opened |= {("in", each.topic_name, named(each.msg_type)) for each in node.subscriptions}
    listed = {
        (topic.direction, resolved(topic.name), topic.type)
        for topic in TOPICS
        if topic.direction != "service"  # a node of their own has them
        and (not topic.needs.startswith("orientation") or topic.needs.endswith(f" {orientation}"))
    }
    assert {each for each in opened if each[2].startswith(OWN)} == listed


def named(kind: type) -> str:
    """package/Type of a message or service class."""
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def resolved(name: str) -> str:
    """What a node of the default name makes of it."""
    return name.replace("~", "/drape_node") if name[0] in "~/" else f"/{name}"
