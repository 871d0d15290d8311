"""Drape nodes in the tests' own process, each with other parameters, and what changes while they run."""

from __future__ import annotations

import sys
from itertools import count
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, SplatDraper, Splats, load_avatar, load_garment_model
from physkin_core.model.model_file import MODELS_PATH
from physkin_core.points.point_files import read_splat_file
from physkin_core.points.splat_draper import SplatSkinner, bind_splats

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from builtin_interfaces.msg import Time  # noqa: E402
from core.points.splat_files import splat_ply  # noqa: E402
from geometry_msgs.msg import Quaternion, TransformStamped  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rclpy.lifecycle import TransitionCallbackReturn  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import Imu, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from physkin_ros.joints.joint_states import JointStateReader  # noqa: E402
from physkin_ros.joints.ros4hri import Ros4hriNaming  # noqa: E402
from physkin_ros.messages.interfaces import missing_interfaces  # noqa: E402
from physkin_ros.messages.splat_cloud import read_splats  # noqa: E402
from physkin_ros.node import garment_stream  # noqa: E402
from physkin_ros.node.asset_loading import OutfitLoader  # noqa: E402

STAMPS = ((sec, 0) for sec in count(1000))  # one for each joint state whose stamp does not matter


def test_gravity_messages(peer, running_node, leaning_model_path, leaning_draper):
    """A direction of any length goes with the joint states after it; what is no direction leaves the last good one."""
    draper = leaning_draper
    names, positions = draper.joint_names, np.linspace(-0.2, 0.2, len(draper.joint_names)).astype(np.float32)
    with running_node({"model": str(leaning_model_path)}):
        upright = peer.cloud(names, positions, (1, 0))
        for index, down in enumerate(np.array([[4.0, -2.0, -5.0], [0, 0, 0.01], [1.0, 0.0, 0.0]])):
            peer.send_gravity(down)
            tilted = peer.cloud(names, positions, (2, index))
            np.testing.assert_allclose(tilted, draper.drape(positions, down), atol=1e-6)
            assert np.abs(tilted - upright).max() > 1e-3
        for index, bad in enumerate([(0, 0, 0), (0, np.nan, -1), (np.inf, 0, 0), (1e200, 1e200, 1e200)], start=1):
            peer.send_gravity(bad)
            peer.until_told("gravity messages rejected", str(index))
            np.testing.assert_array_equal(peer.cloud(names, positions, (3, index)), tilted)
        assert peer.latest("joint states rejected") == "0" and peer.latest("gravity") == "1.000 0.000 0.000"
        # by their stamps, whatever the order they come in
        earlier, later = np.array([0.0, 1.0, 0.0]), np.array([0.0, -1.0, 0.0])
        for down, stamp in ((earlier, (50, 0)), (later, (51, 0))):
            peer.send_gravity(down, stamp)
        for down, stamp in ((earlier, (50, 500)), (later, (51, 0)), (earlier, (50, 1))):
            np.testing.assert_allclose(peer.cloud(names, positions, stamp), draper.drape(positions, down), atol=1e-6)


def test_ros4hri_joint_states(peer, running_node, model_path, draper):
    """With joint_map ros4hri, bodies of REP-155 are understood, id and all."""
    with running_node({"model": str(model_path), "joint_map": "ros4hri"}):
        names, angles = ["l_p_shoulder_67dd1", "l_elbow_67dd1", "waist_67dd1"], [1.0, 0.5, 0.3]
        rig = draper.model.rig
        state = JointStateReader(rig.joint_names, rig.rest, naming=Ros4hriNaming(rig)).read(names, angles)
        np.testing.assert_allclose(peer.cloud(names, angles, (1, 0)), draper.drape(state), atol=1e-6)


def test_precision_and_marker(peer, running_node, model_path, draper):
    """A marker goes to those who listen; joints beyond what was trained are named."""
    expected = Draper(draper.model, draper.avatar, precision="fp32")
    rig = draper.model.rig
    state = np.random.default_rng(3).uniform(rig.lower, rig.upper).astype(np.float32)
    state[1] = rig.upper[1] + 1.0
    markers = []
    subscription = peer.node.create_subscription(Marker, "drape_node/marker", markers.append, 5)
    with running_node({"model": str(model_path), "precision": "fp32"}) as node:
        peer.until(subscription.get_publisher_count, "marker's publisher")
        cloud = peer.cloud(draper.joint_names, state, (3, 4))
        np.testing.assert_array_equal(cloud, expected.drape(state))
        peer.until(lambda: markers, "marker")
        peer.until_told("precision", "fp32")
        beyond = lambda: any(rig.joint_names[1] in each["outside the trained range"] for each in peer.reports)  # noqa: E731
        peer.until(beyond, "the joint that is too far")
        (result,) = node.set_parameters([Parameter("precision", value="int8")])
        assert not result.successful
    peer.node.destroy_subscription(subscription)
    corners = np.array([(point.x, point.y, point.z) for point in markers[0].points[:30]])
    np.testing.assert_array_equal(corners, cloud[draper.faces.ravel()[:30], :3])
    assert len(markers[0].points) == draper.faces.size and markers[0].header.stamp.nanosec == 4


def test_one_size(peer, running_node, model_path):
    """Where it is asked for; that cloth is made to measure, all others drape."""
    model = load_garment_model(model_path)
    draper, rest = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig), fit=0.0), model.rig.rest.astype(np.float32)
    with running_node({"model": str(model_path), "fit": 0.0}):
        np.testing.assert_array_equal(peer.cloud(draper.joint_names, rest, next(STAMPS)), draper.drape(rest))
        peer.until_told("fit", "0")


def test_gravity_by_an_imu(peer, running_node, leaning_model_path, leaning_draper):
    """Best effort, as its drivers are; effective gravity is told while it comes."""
    names, rest = list(leaning_draper.joint_names), leaning_draper.model.rig.rest
    tilted = np.array([np.sin(0.6), 0.0, -np.cos(0.6)])  # pitched forward
    with running_node({"model": str(leaning_model_path), "orientation": "imu"}, gravity=False):
        message = Imu()
        message.orientation.y, message.orientation.w = np.sin(0.3), np.cos(0.3)
        publisher = peer.node.create_publisher(Imu, "imu", qos_profile_sensor_data)
        peer.until(publisher.get_subscription_count, "subscription to the IMU")
        publisher.publish(message)
        peer.spin(0.2)
        cloud = peer.cloud(names, rest, (2, 0))
        np.testing.assert_allclose(cloud, leaning_draper.drape(rest, tilted), atol=1e-5)
        message.header.stamp.sec, message.linear_acceleration.z = 3, 9.81
        publisher.publish(message)
        peer.until_told("effective gravity [m/s2]", "5.54 ")
        peer.until_told("effective gravity [m/s2]", "none")
        peer.node.destroy_publisher(publisher)


def test_tf_says_where_the_root_is(peer, running_node, leaning_model_path, leaning_draper):
    """A bad message is told and leaves the last good one. By odometry: test_many_avatars.py."""
    messages = pytest.importorskip("tf2_msgs.msg", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")
    names, rest = list(leaning_draper.joint_names), leaning_draper.model.rig.rest
    parameters = {"orientation": "tf", "frame_id": "hips", "world_frame": "map"}
    with running_node({"model": str(leaning_model_path)} | parameters, gravity=False):
        publisher = peer.node.create_publisher(messages.TFMessage, "/tf", 10)

        def send(half: float, sec: int) -> None:
            message = TransformStamped(header=Header(stamp=Time(sec=sec), frame_id="map"), child_frame_id="hips")
            message.transform.translation.x = 2.5
            message.transform.rotation = Quaternion(y=np.sin(half), w=np.cos(half))
            publisher.publish(messages.TFMessage(transforms=[message]))
            peer.spin(0.2)

        peer.until(publisher.get_subscription_count, "subscription")
        peer.cloud(names, rest, (1, 0))
        peer.until_told("last rejection", "no transform from 'map' to 'hips'")
        send(0.3, 2)
        tilted = np.array([np.sin(0.6), 0.0, -np.cos(0.6)])
        for sec in (2, 3):
            np.testing.assert_allclose(peer.cloud(names, rest, (sec, 0)), leaning_draper.drape(rest, tilted), atol=1e-5)
            send(np.nan, 3)
            peer.until_told("last rejection", "unit quaternion")
        assert peer.frame_ids == {"hips"}
        peer.node.destroy_publisher(publisher)


def test_splats(peer, running_node, leaning_model_path, leaning_draper, tmp_path, capfd):
    """Draped as the cloud is, what does not move once; a file that will not do is one sentence."""
    model, rest = leaning_draper.model, leaning_draper.model.rig.rest
    path, far, plain = tmp_path / "splats.ply", tmp_path / "far.ply", tmp_path / "plain.ply"
    path.write_bytes(splat_ply("binary_big_endian", model.garment.vertices[::5]))
    far.write_bytes(splat_ply("ascii", model.garment.vertices[:9] + 1))
    plain.write_text("ply\nformat ascii 1.0\nelement vertex 1\n" + "property float x\nproperty float y\n"
                     "property float z\nend_header\n0 0 0\n")  # fmt: skip
    parameters = {"model": str(leaning_model_path), "frame_id": "hips"}
    for wrong, reason in (
        (tmp_path / "none.ply", "no such file"),
        (far, "cm from garment"),
        (plain, "they are no Gaussian splats"),
    ):
        with pytest.raises(ValueError, match=f"parameter splats.*{reason}") as error:
            with running_node(parameters | {"splats": str(wrong)}):
                pass
        assert "\n" not in str(error.value)
    heard, looks = [], []
    with running_node(parameters | {"splats": str(path)}):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscriptions = [
            peer.node.create_subscription(PointCloud2, "drape_node/splats", heard.append, 10),
            peer.node.create_subscription(PointCloud2, "drape_node/splat_attributes", looks.append, latched),
        ]
        peer.until(lambda: looks, "what does not move")
        peer.until(subscriptions[0].get_publisher_count, "splats")
        peer.spin(0.3)
        tilted = np.array([np.sin(0.6), 0.0, -np.cos(0.6)])
        peer.send_gravity(tilted)
        cloud = peer.cloud(model.rig.joint_names, rest, (7, 8))
        peer.until(lambda: heard, "draped splats")
    (message, *_), (look, *_) = heard, looks
    assert (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id) == (7, 8, "hips")
    file, splats = read_splat_file(path), read_splats(message)
    expected = SplatDraper(model, leaning_draper.avatar, file.splats).drape(rest, tilted)
    np.testing.assert_allclose(splats.centres, expected.centres, atol=1e-6)
    np.testing.assert_allclose(splats.centres, cloud[::5, :3], atol=2e-3)
    np.testing.assert_allclose(splats.scales, expected.scales, rtol=1e-3)
    np.testing.assert_allclose(splats.rotations, expected.rotations, atol=1e-4)
    column = [field.name for field in look.fields].index("opacity")
    table = np.frombuffer(look.data, dtype=np.float32).reshape(look.width, len(look.fields))
    np.testing.assert_array_equal(table[:, column], file.look["opacity"])
    for subscription in subscriptions:
        peer.node.destroy_subscription(subscription)


def test_splats_leave_half_of_the_time_to_clouds(draper, monkeypatch):
    """After frames that took long, none are made for as long."""
    points = draper.model.garment.vertices[:4]
    splats = Splats(points, np.tile([0.0, 0, 0, 1], (4, 1)), np.full((4, 3), 0.004))
    messages, published = garment_stream.SplatMessages(SplatSkinner(bind_splats(draper.layer, splats)), "root"), []
    draper.drape(draper.model.rig.rest)
    publisher = SimpleNamespace(handle=SimpleNamespace(publish_raw=published.append))
    times = iter([100, 130, 140, 159, 160, 161, 161, 162])  # a frame reads the clock at its end, too
    monkeypatch.setattr(garment_stream, "perf_counter_ns", lambda: next(times))
    counts = []
    for _ in range(5):
        messages.publish(publisher, draper.node_transforms(), draper.detail_offsets(), 1, 2)
        counts.append(len(published))
    assert counts == [1, 1, 1, 2, 2]


def test_without_autostart_and_interfaces(peer, running_node, model_path, draper, monkeypatch, capfd):
    """The node waits for its transitions and counts what comes before; without physkin_msgs there are clouds and
    parameters all the same, and the log says what is missing and how to install it."""
    missing = "physkin_msgs is not installed: ... build.py --install"
    for module in ("drape_node", "garment_stream", "reports"):
        monkeypatch.setattr(f"physkin_ros.node.{module}.missing_interfaces", lambda: missing)
    names, rest = draper.joint_names, draper.model.rig.rest.astype(np.float32)
    with running_node({"model": str(model_path), "autostart": False}, connect=False) as node:
        assert missing in capfd.readouterr().err
        assert not peer.node.count_publishers("drape_node/garment")
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        peer.connect(settle=0.1)
        for _ in range(3):
            peer.send(names, rest, next(STAMPS))
        peer.until_told("joint states before a garment was ready", "3")
        assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        np.testing.assert_array_equal(peer.cloud(names, rest, next(STAMPS)), draper.drape(rest))
        assert len(peer.clouds) == 1
        topics = [topic for topic, _ in peer.node.get_topic_names_and_types()]
        assert "/drape_node/mesh" not in topics and "/drape_node/statistics" not in topics
        (result,) = node.set_parameters([Parameter("body_mesh", value="/etc/passwd")])
        assert not result.successful and "asset_roots" in result.reason
        (result,) = node.set_parameters([Parameter("model", value="tshirt")])
        assert result.successful
        shirt = len(load_garment_model("tshirt").garment.vertices)
        peer.until(lambda: len(peer.cloud(names, rest, next(STAMPS))) == shirt, "the other garment")


def test_interfaces_are_told_from_none(monkeypatch):
    """Here they are installed, in this version; where they are not, the command that installs them is named."""
    pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")
    assert missing_interfaces() == ""
    monkeypatch.setitem(sys.modules, "physkin_msgs.srv", None)
    assert "python msg_defs/wheel/build.py --install" in missing_interfaces()


def test_a_change_of_mind_counts(peer, running_node, model_path, draper, monkeypatch, capfd):
    """A model that is set and set back while it loads is not worn; one that there is not is refused at once."""
    started, released, finished = Event(), Event(), Event()
    load = OutfitLoader.load

    def slow(self, avatar):
        awaited = avatar.garments[0].model == "tshirt"
        if awaited:
            started.set()
            assert released.wait(20)
        loaded = load(self, avatar)
        if awaited:
            finished.set()
        return loaded

    names, rest = draper.joint_names, draper.model.rig.rest
    with running_node({"model": str(model_path)}) as node:
        monkeypatch.setattr(OutfitLoader, "load", slow)
        for model in ("tshirt", str(model_path)):
            (result,) = node.set_parameters([Parameter("model", value=model)])
            assert result.successful and started.wait(20)
        released.set()
        peer.until(finished.is_set, "the garment that is not wanted any more")
        peer.spin(0.3)
        assert len(peer.cloud(names, rest, next(STAMPS))) == draper.vertex_count
        assert node.get_parameter("model").value == str(model_path)
        assert "tshirt with" not in capfd.readouterr().err
        (result,) = node.set_parameters([Parameter("model", value="kilt")])
        assert not result.successful and "'kilt'" in result.reason
        peer.reports.clear()
        peer.until_told("last error", "none")


def test_nothing_comes_in_before_the_garment_is_there(peer, running_node, model_path, monkeypatch):
    """Or joint states would be lost without being counted."""
    subscribed = []
    load = OutfitLoader.load

    def watched(*given):
        subscribed.append(peer.node.count_subscribers("joint_states"))
        return load(*given)

    monkeypatch.setattr(OutfitLoader, "load", watched)
    with running_node({"model": str(model_path)}):
        assert subscribed == [0] and peer.node.count_subscribers("joint_states") == 1


def test_lifecycle(peer, running_node, model_path, draper):
    """Deactivated it answers nothing, cleaned up it has no topics, and a transition that is none does no harm."""
    names, rest = draper.joint_names, draper.model.rig.rest.astype(np.float32)

    def change(label: str, number: int = 0) -> bool:
        transition = Transition(id=number, label=label)
        return peer.call(ChangeState, "change_state", transition=transition).success

    with running_node({"model": str(model_path)}) as node:
        for label, state in (("deactivate", "inactive"), ("cleanup", "unconfigured"), ("configure", "inactive")):
            assert change(label) and peer.call(GetState, "get_state").current_state.label == state
            assert not change("dance") and not change("", 97)
            peer.send(names, rest, next(STAMPS))
            peer.spin(0.2)
            assert not peer.clouds
            assert (node.count_publishers("drape_node/garment") == 0) == (state == "unconfigured")
        assert change("activate")
        peer.connect(settle=0.3)
        np.testing.assert_array_equal(peer.cloud(names, rest, next(STAMPS)), draper.drape(rest))


def test_configuring_fails_with_a_reason(peer, running_node, tmp_path, capfd):
    """And can be tried again once the file is there."""
    path = tmp_path / "late.safetensors"
    with running_node({"model": str(path), "autostart": False}, connect=False) as node:
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert "cannot configure: garment model" in capfd.readouterr().err
        path.write_bytes((MODELS_PATH / "tshirt.safetensors").read_bytes())
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
