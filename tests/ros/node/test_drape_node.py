"""The drape node in the test's own process: what it makes of good and bad joint states."""

from __future__ import annotations

import importlib.util
from contextlib import contextmanager

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model
from physkin_core.model.model_file import MODELS_PATH
from physkin_core.runtime import push_out

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from rclpy.lifecycle import TransitionCallbackReturn  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from physkin_ros.joints.joint_states import JointStateReader  # noqa: E402
from physkin_ros.joints.ros4hri import Ros4hriNaming  # noqa: E402
from physkin_ros.node.drape_node import DrapeNode  # noqa: E402


@pytest.fixture
def drape_node(peer, model_path):
    """A node that drapes the test's garment on the bundled avatar."""
    with running_node(peer, {"model": str(model_path)}) as node:
        yield node


@pytest.fixture(scope="module")
def draper(garment_model) -> Draper:
    """What the node should compute."""
    return Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))


def test_order_extra_and_missing_joints(peer, drape_node, draper):
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


def test_stamps_are_verbatim(peer, drape_node, draper):
    """Clouds carry the joint states' stamps to the nanosecond, also ones that jump back, and the frame asked for."""
    stamps = [(0, 0), (1, 999_999_999), (2_000_000_000, 1), (7, 3)]
    for stamp in stamps:
        peer.cloud(draper.joint_names, draper.model.rig.rest, stamp)
    assert sorted(peer.clouds) == sorted(stamps)
    assert peer.frame_ids == {"base_link"}


def test_bad_joint_states_leave_the_last_good_state(peer, drape_node, draper, capfd):
    """Each is warned about and shows in the diagnostics, no cloud answers it, and the next one goes on from before."""
    names = list(draper.joint_names)
    good = np.linspace(-0.2, 0.2, len(names)).astype(np.float32)
    peer.cloud(names, good, (1, 0))
    bad = [
        (names, [*good[:-1], np.nan], f"{names[-1]!r} is nan"),
        (names, [np.inf, *good[1:]], f"{names[0]!r} is inf"),
        (names, good[:-1], f"{len(names)} names but {len(names) - 1} positions"),
        (["tail", "fin"], [0.0, 0.0], "no joint is known among tail, fin"),
        ([names[0], names[0]], [0.0, 1.0], "are the same joint"),
        ([], [], "names no joints"),
    ]
    for count, (bad_names, values, reason) in enumerate(bad, start=1):
        peer.send(bad_names, values, (2, count))
        peer.spin_until(lambda n=count: _latest(peer, "joint states rejected") == str(n), "diagnostics")
        assert reason in _latest(peer, "last rejection")
    assert "joint state ignored: the position of joint" in capfd.readouterr().err
    assert list(peer.clouds) == [(1, 0)]
    good[2] = 0.15
    np.testing.assert_array_equal(peer.cloud(names[2:3], good[2:3], (3, 0)), draper.drape(good))


def test_diagnostics(peer, drape_node, draper):
    """Once a second, with what a person who looks for a fault needs."""
    for index in range(5):
        peer.cloud(draper.joint_names, draper.model.rig.rest, (index, 0))
    peer.spin_until(lambda: _latest(peer, "clouds published") == "5", "diagnostics")
    report = next(report for report in peer.reports if report["evaluation p50 [us]"] != "none")
    assert 0 < float(report["evaluation p50 [us]"]) <= float(report["evaluation p99 [us]"])
    assert (report["model"], report["backend"]) == ("vest", "native")
    assert report["instruction set"] in ("baseline", "v3", "v4", "v4_vnni")
    assert float(report["last stamp age [s]"]) > 0
    assert report["precision"] == "bf16" and "vertices left inside" not in report


def test_gravity_can_change_while_running(peer, drape_node, draper):
    """A tilted root is draped as such; a direction that is none is refused."""
    names, rest = draper.joint_names, draper.model.rig.rest
    down = [0.0, 0.6, -0.8]
    (result,) = drape_node.set_parameters([Parameter("gravity", value=down)])
    assert result.successful
    np.testing.assert_array_equal(peer.cloud(names, rest, (1, 0)), draper.drape(rest, np.array(down)))
    for wrong in ([0.0, 0.0, 0.0], [0, -1], [True, False, True], "down", 9.81, None):
        (result,) = drape_node.set_parameters([Parameter("gravity", value=wrong)])
        assert not result.successful and f"gravity is {wrong!r}; it must be three finite" in result.reason
    (result,) = drape_node.set_parameters([Parameter("gravity", value=[0, 1, 0])])
    assert result.successful
    np.testing.assert_array_equal(peer.cloud(names, rest, (2, 0)), draper.drape(rest, np.array([0, 1, 0])))
    (result,) = drape_node.set_parameters([Parameter("backend", value="numpy")])
    assert not result.successful


def test_gravity_messages(peer, leaning_model_path):
    """A direction of any length goes with the joint states after it; what is no direction leaves the last good one."""
    model = load_garment_model(leaning_model_path)
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    names, positions = draper.joint_names, np.linspace(-0.2, 0.2, len(draper.joint_names)).astype(np.float32)
    with running_node(peer, {"model": str(leaning_model_path)}):
        upright = peer.cloud(names, positions, (1, 0))
        for index, down in enumerate(np.array([[4.0, -2.0, -5.0], [0, 0, 0.01], [1.0, 0.0, 0.0]])):
            peer.send_gravity(down)
            tilted = peer.cloud(names, positions, (2, index))
            np.testing.assert_allclose(tilted, draper.drape(positions, down), atol=1e-6)
            assert np.abs(tilted - upright).max() > 1e-3
        for count, bad in enumerate([(0, 0, 0), (0, np.nan, -1), (np.inf, 0, 0), (1e200, 1e200, 1e200)], start=1):
            peer.send_gravity(bad)
            peer.spin_until(lambda n=count: _latest(peer, "gravity messages rejected") == str(n), "diagnostics")
            assert "must be three finite numbers" in _latest(peer, "last rejection")
            np.testing.assert_array_equal(peer.cloud(names, positions, (3, count)), tilted)
        assert _latest(peer, "joint states rejected") == "0" and _latest(peer, "gravity") == "1.000 0.000 0.000"


def test_ros4hri_joint_states(peer, model_path, draper):
    """With joint_map ros4hri, bodies of REP-155 are understood, id and all."""
    with running_node(peer, {"model": str(model_path), "joint_map": "ros4hri"}):
        names, angles = ["l_p_shoulder_67dd1", "l_elbow_67dd1", "waist_67dd1"], [1.0, 0.5, 0.3]
        rig = draper.model.rig
        state = JointStateReader(rig.joint_names, rig.rest, naming=Ros4hriNaming(rig)).read(names, angles)
        np.testing.assert_allclose(peer.cloud(names, angles, (1, 0)), draper.drape(state), atol=1e-6)


def test_precision_and_push_out(peer, model_path, draper, monkeypatch):
    """Clouds are the core's with both, and with normals of faces, unlike those without; the diagnostics tell what is
    left inside."""
    monkeypatch.setattr(push_out, "BIND_POSES", 8)
    options = {"precision": "fp32", "push_out": True, "normals": "faces"}
    expected = Draper(draper.model, draper.avatar, **options)
    rig = draper.model.rig
    state = np.random.default_rng(3).uniform(rig.lower, rig.upper).astype(np.float32)
    with running_node(peer, {"model": str(model_path), **options}) as node:
        cloud = peer.cloud(draper.joint_names, state, (1, 0))
        np.testing.assert_array_equal(cloud, expected.drape(state))
        pushed = Draper(draper.model, draper.avatar, push_out=True).drape(state)
        apart = np.abs(cloud - pushed)
        assert apart[:, :3].any() and apart[:, :3].mean() < 1e-3 and apart[:, 3:].max() > 0.1
        assert (np.abs(cloud - draper.drape(state))[:, :3].max(axis=1) > 1e-3).any()
        peer.spin_until(lambda: _latest(peer, "clouds published") == "1", "diagnostics")
        assert _latest(peer, "precision") == "fp32"
        assert _latest(peer, "vertices left inside") == str(expected.residual.left_inside)
        assert _latest(peer, "deepest left inside [mm]") == f"{1e3 * expected.residual.deepest:.2f}"
        for name, value in {"precision": "int8", "push_out": False}.items():
            (result,) = node.set_parameters([Parameter(name, value=value)])
            assert not result.successful


def test_clouds_at_a_rate_of_their_own(peer, model_path, draper):
    """Between two joint states clouds come with stamps between theirs, poses on the way, and end at the second."""
    names, rest = draper.joint_names, draper.model.rig.rest.astype(np.float32)
    bent = rest.copy()
    bent[:2] += 0.2
    with running_node(peer, {"model": str(model_path), "cloud_rate": 200.0}):
        peer.send(names, rest, (10, 0))
        peer.spin(0.2)
        peer.send(names, bent, (11, 0))
        peer.spin_until(lambda: (11, 0) in peer.clouds, "last cloud")
        peer.spin(0.2)
    stamps = sorted(peer.clouds)
    assert stamps[0] == (10, 0) and stamps[-1] == (11, 0) and len(stamps) > 10
    np.testing.assert_array_equal(peer.clouds[10, 0], draper.drape(rest))
    np.testing.assert_array_equal(peer.clouds[11, 0], draper.drape(bent))
    between = stamps[len(stamps) // 2]
    share = between[1] / 1e9
    np.testing.assert_allclose(peer.clouds[between], draper.drape(rest + share * (bent - rest)), atol=1e-4)


@pytest.mark.parametrize("orientation", ["joints", "imu", "fixed"])
def test_other_orientations(peer, leaning_model_path, orientation):
    """Roll and pitch among the joints; an IMU's orientation; or none, and the topic gravity is not listened to."""
    model = load_garment_model(leaning_model_path)
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    names, rest = list(draper.joint_names), model.rig.rest
    tilted = np.array([np.sin(0.6), 0.0, -np.cos(0.6)])  # pitched forward
    parameters = {"model": str(leaning_model_path), "orientation": orientation}
    with running_node(peer, parameters, gravity=False):
        if orientation == "joints":
            peer.cloud(names, rest, (1, 0))
            peer.spin_until(lambda: "no joint 'root_roll'" in _latest(peer, "last rejection"), "diagnostics")
            cloud = peer.cloud([*names, "root_roll", "root_pitch"], [*rest, 0.0, 0.6], (2, 0))
        elif orientation == "imu":
            message = Imu()
            message.orientation.y, message.orientation.w = np.sin(0.3), np.cos(0.3)
            publisher = peer.node.create_publisher(Imu, "imu", 5)
            peer.spin_until(publisher.get_subscription_count, "subscription to the IMU")
            publisher.publish(message)
            peer.spin(0.2)
            cloud = peer.cloud(names, rest, (2, 0))
        else:
            assert not peer.node.count_subscribers("gravity")
            tilted = np.array([0.0, 0.0, -1.0])
            cloud = peer.cloud(names, rest, (2, 0))
        np.testing.assert_allclose(cloud, draper.drape(rest, tilted), atol=1e-5)


def test_tf_needs_its_messages(peer, model_path):
    """Where they are not installed, the parameter is refused with what would do."""
    if importlib.util.find_spec("tf2_msgs"):
        pytest.skip("tf2_msgs is installed")
    with pytest.raises(ValueError, match="orientation is 'tf', which needs the package tf2_msgs"):
        with running_node(peer, {"model": str(model_path), "orientation": "tf"}):
            pass


def test_marker(peer, model_path, draper):
    """The cloud's triangles for RViz, when asked for."""
    markers = []
    peer.node.create_subscription(Marker, "drape_node/marker", markers.append, 5)
    with running_node(peer, {"model": str(model_path), "marker": True}):
        cloud = peer.cloud(draper.joint_names, draper.model.rig.rest, (3, 4))
        peer.spin_until(lambda: markers, "marker")
    corners = np.array([(point.x, point.y, point.z) for point in markers[0].points[:30]])
    np.testing.assert_array_equal(corners, cloud[draper.faces.ravel()[:30], :3])
    assert len(markers[0].points) == draper.faces.size and markers[0].header.stamp.nanosec == 4


def test_deadline_and_range_are_reported(peer, model_path, draper):
    """Joint states that took too long, and joints beyond what was trained, with where they were."""
    rig = draper.model.rig
    pose = rig.rest.astype(np.float32)
    pose[1] = rig.upper[1] + 1.0
    with running_node(peer, {"model": str(model_path), "deadline": 1e-9}):
        peer.cloud(rig.joint_names, pose, (1, 0))
        peer.spin_until(lambda: _latest(peer, "deadline missed") == "1", "diagnostics")
        assert rig.joint_names[1] in _latest(peer, "outside the trained range")


def test_without_autostart_and_interfaces(peer, model_path, draper, monkeypatch):
    """The node waits for its transitions; without physkin_msgs there are clouds and parameters all the same."""
    for name in ("drape_node.DrapeStatistics", "drape_node.SwapServices", "garment_stream.GarmentMesh"):
        monkeypatch.setattr(f"physkin_ros.{name}", None)
    parameters = {"model": str(model_path), "autostart": False}
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    node = DrapeNode(context=peer.context, parameter_overrides=overrides)
    peer.executor.add_node(node)
    try:
        assert not peer.node.count_publishers("drape_node/garment")
        for trigger in (node.trigger_configure, node.trigger_activate):
            assert trigger() == TransitionCallbackReturn.SUCCESS
        peer.connect()
        names, rest = draper.joint_names, draper.model.rig.rest.astype(np.float32)
        np.testing.assert_array_equal(peer.cloud(names, rest, (1, 0)), draper.drape(rest))
        topics = [topic for topic, _ in peer.node.get_topic_names_and_types()]
        assert "/drape_node/mesh" not in topics and "/drape_node/statistics" not in topics
        (result,) = node.set_parameters([Parameter("body_mesh", value="/etc/passwd")])
        assert not result.successful and "outside the parameter asset_roots" in result.reason
        (result,) = node.set_parameters([Parameter("model", value="tshirt")])
        assert result.successful
        shirt = len(load_garment_model("tshirt").garment.vertices)
        stamps = iter(range(2, 1000))
        peer.spin_until(lambda: len(peer.cloud(names, rest, (next(stamps), 0))) == shirt, "the other garment")
    finally:
        node.destroy_node()


def test_configuring_fails_with_a_reason(peer, tmp_path, capfd):
    """And can be tried again once the file is there."""
    path = tmp_path / "late.safetensors"
    overrides = [Parameter("model", value=str(path)), Parameter("autostart", value=False)]
    node = DrapeNode(context=peer.context, parameter_overrides=overrides)
    try:
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert "cannot configure: cannot read garment model" in capfd.readouterr().err
        path.write_bytes((MODELS_PATH / "tshirt.safetensors").read_bytes())
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    finally:
        node.destroy_node()


@contextmanager
def running_node(peer, parameters, gravity=True):
    """A drape node in the peer's executor. gravity: whether it subscribes to that topic."""
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    node = DrapeNode(context=peer.context, parameter_overrides=overrides)
    peer.executor.add_node(node)
    try:
        peer.connect(gravity=gravity)
        yield node
    finally:
        node.destroy_node()


def _latest(peer, key: str) -> str:
    return peer.reports[-1][key] if peer.reports else ""
