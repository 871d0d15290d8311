"""`physkin view --ros`: what a node publishes reaches the page."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")
pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

import rclpy  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from root_messages import transform  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model  # noqa: E402
from physkin_core.view.page import Page  # noqa: E402
from physkin_core.view.surface_node import SurfaceNode  # noqa: E402
from physkin_ros.messages.conversions import GarmentCloud, garment_mesh  # noqa: E402
from physkin_ros.tools.view import CloudListener, GarmentSeen, RosPage, _spin  # noqa: E402


@pytest.fixture(scope="module")
def listening(domain):
    """A listener, a publisher's ROS node, and both spun."""
    from physkin_msgs.msg import GarmentMesh

    rclpy.init(args=[])
    listener, other = CloudListener(), rclpy.create_node("somebody")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    topics = {
        "cloud": other.create_publisher(PointCloud2, "/drape_node/garment", 1),
        "mesh": other.create_publisher(GarmentMesh, "/drape_node/mesh", latched),
        "joints": other.create_publisher(JointState, "joint_states", qos_profile_sensor_data),
    }
    executor = SingleThreadedExecutor()
    executor.add_node(listener)
    executor.add_node(other)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    yield listener, topics
    executor.shutdown()
    spinning.join(5)
    listener.destroy_node()
    other.destroy_node()
    rclpy.try_shutdown()


def until(true, again=lambda: None):
    end = time.monotonic() + 20
    while not true():
        assert time.monotonic() < end
        again()
        time.sleep(0.05)


def test_clouds_and_mesh_are_drawn(asset_loader, listening):
    """A cloud as a surface once its mesh is known, the body in the pose of the joint states, faults as an error."""
    listener, topics = listening
    model = load_garment_model("skirt")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    cloud = GarmentCloud(draper.vertex_count, "root")
    draper.drape(model.rig.rest, out=cloud.points)
    joints = JointState(name=["spine03_x"], position=[0.15])
    page = Page(port=8490)
    try:
        drawn = RosPage(page, listener, body=asset_loader.avatar(BUNDLED_AVATAR))
        seen = lambda: listener.garments.get("/drape_node/garment")  # noqa: E731

        def send():
            cloud.publish(topics["cloud"], 1, 2)
            topics["joints"].publish(joints)

        body = listener.bodies["joint_states"]
        until(lambda: seen() and seen().points is not None and body.positions, send)
        drawn.tick(1.0)
        assert not isinstance(drawn._cloths["/drape_node/garment"][0], SurfaceNode)
        topics["mesh"].publish(garment_mesh(draper.outfit, 0, "root"))
        until(lambda: seen().faces is not None, send)
        seen().clouds += 1
        drawn.tick(0.1)
        assert isinstance(drawn._cloths["/drape_node/garment"][0], SurfaceNode)
        np.testing.assert_array_equal(seen().points, cloud.points)
        assert body.positions == {"spine03_x": pytest.approx(0.15)} and list(drawn._bodies) == ["joint_states"]
        topics["cloud"].publish(PointCloud2())
        until(lambda: seen().fault)
        with pytest.raises(ValueError, match="/drape_node/garment: no garment cloud"):
            drawn.tick(0.1)
        drawn.tick(0.1)
    finally:
        page.server.stop()


def test_hostile_meshes_and_names_end_nothing(listening):
    """Each is told, and one of an earlier version, which ends early; mesh and pose that were known stay, and the
    next cloud is drawn."""
    from physkin_msgs.msg import GarmentMesh

    listener, topics = listening
    until(lambda: "/drape_node/garment" in listener.garments)
    seen = listener.garments["/drape_node/garment"]
    seen.faces, seen.layer, seen.layers, seen.fault = None, 0, 1, ""
    for fields, told in (
        ({"faces": [0, 1, 2, 3]}, "has 4 indices of faces; allowed: three for each"),
        ({"faces": [0, 1, 9]}, "has face index 9 of 9 vertices"),
        ({"layer": 9}, "is layer 9 of 1; allowed: 0 to 3, of up to 4"),
        ({"layers": 2**32 - 1}, "is layer 0 of 4294967295"),
    ):
        mesh = GarmentMesh(**({"faces": [0, 1, 2], "vertex_count": 9, "layers": 1} | fields), model_name="\x1b[2J" * 99)
        topics["mesh"].publish(mesh)
        until(lambda: seen.fault)
        assert told in seen.fault and seen.fault.isprintable() and len(seen.fault) < 200
        seen.fault = ""
    topics["mesh"].publish(serialize_message(GarmentMesh(faces=[0, 1, 2], vertex_count=9, layers=1))[:-12])
    until(lambda: seen.fault)
    assert "no GarmentMesh as physkin_msgs has it here" in seen.fault
    seen.fault = ""
    assert seen.faces is None and (seen.layer, seen.layers) == (0, 1)
    body = listener.bodies["joint_states"]
    for k in range(9):
        names = ["spine03_x", *(f"{k}{n}" for n in range(99))]
        topics["joints"].publish(JointState(name=names, position=[0.01 * k] * len(names)))
    until(lambda: body.positions.get("spine03_x") == pytest.approx(0.08))
    assert len(body.positions) == 1
    cloud = GarmentCloud(9, "root" * 1000)
    until(lambda: seen.fault, lambda: cloud.publish(topics["cloud"], 1, 2))
    assert "has more than 256 characters" in seen.fault
    seen.fault = ""


def test_a_callback_that_fails_ends_itself_alone(domain):
    """Others are served on."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=domain)
    listener, served = CloudListener(context=context), []

    def fail() -> None:
        served.append(True)
        raise ValueError("odd")

    listener.create_timer(0.01, fail)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listener)
    spinning = threading.Thread(target=_spin, args=(executor, listener))
    spinning.start()
    try:
        until(lambda: len(served) > 5)
    finally:
        executor.shutdown()
        spinning.join(5)
        assert not spinning.is_alive()
        listener.destroy_node()
        rclpy.shutdown(context=context)


def test_figures_stand_where_tf_says(asset_loader, domain):
    """In the world that TF is of, seen from their middle; bodies in the frame of the clouds that bear their name; what
    TF does not know stands in a row."""
    pytest.importorskip("tf2_msgs", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=domain)
    listener = CloudListener(["/alice/joint_states", "/bob/joint_states"], context=context)
    page = Page(port=8492)
    try:
        drawn = RosPage(page, listener, body=asset_loader.avatar(BUNDLED_AVATAR))
        for avatar in ("alice", "bob", "carol", "dan"):
            points = np.zeros((3, 6), dtype=np.float32)
            listener.garments[f"/drape_node/{avatar}/top/garment"] = GarmentSeen(points, f"{avatar}_root", clouds=1)
            drawn.tick(0.1)
        rows = [drawn._figures[f"{avatar}_root"].position.tolist() for avatar in ("alice", "bob", "carol", "dan")]
        np.testing.assert_allclose(rows, [(0, y, 0.95) for y in (-1.8, -0.6, 0.6, 1.8)])
        turn = (0.0, 0.0, 0.6, 0.8)
        listener._on_transforms([transform("map", "alice_root", place=(3, 1, 1))], False)
        listener._on_transforms([transform("map", "bob_root", place=(5, 1, 1), quaternion=turn)], True)
        drawn.tick(0.1)
        figures = {name: figure.position.tolist() for name, figure in drawn._figures.items()}
        assert figures["alice_root"] == [3, 1, 1] and figures["bob_root"] == [5, 1, 1]
        np.testing.assert_allclose(drawn._figures["bob_root"].wxyz, (0.8, 0, 0, 0.6))
        assert figures["carol_root"] == pytest.approx([0, -0.6, 0.95])
        assert page.world.position.tolist() == [-4, -1, 0]
        listener._on_transforms([transform("map", "alice_root", seconds=2.0, place=(4, 1, 1))], False)
        drawn.tick(0.1)
        assert drawn._figures["alice_root"].position.tolist() == [4, 1, 1]
        assert page.world.position.tolist() == [-4.5, -1, 0]
        bodies = {topic: frame for topic, (frame, _) in drawn._bodies.items()}
        assert bodies == {f"/{who}/joint_states": f"{who}_root" for who in ("alice", "bob")}
    finally:
        page.server.stop()
        listener.destroy_node()
        rclpy.shutdown(context=context)


def test_the_core_reaches_it_by_name():
    """It may not import it."""
    from physkin_core.view.view import ROS_PAGE

    assert (Path(__file__).parents[3] / (ROS_PAGE.replace(".", "/") + ".py")).is_file()
