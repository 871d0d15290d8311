"""`physkin view --ros`: what a node publishes reaches the page."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")
pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

import rclpy  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from root_messages import transform  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model  # noqa: E402
from physkin_core.view.page import Page  # noqa: E402
from physkin_core.view.surface_node import SurfaceNode  # noqa: E402
from physkin_ros.messages.conversions import GarmentCloud, garment_mesh  # noqa: E402
from physkin_ros.tools.view import RosPage  # noqa: E402


@pytest.fixture(scope="module")
def publishing(domain):
    """A ROS node that publishes what a drape node does, in a context of its own: context, publishers."""
    from physkin_msgs.msg import GarmentMesh

    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("somebody", context=context)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    yield (
        context,
        {
            "cloud": node.create_publisher(PointCloud2, "/drape_node/garment", 1),
            "mesh": node.create_publisher(GarmentMesh, "/drape_node/mesh", latched),
            "joints": node.create_publisher(JointState, "joint_states", qos_profile_sensor_data),
        },
    )
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture
def shown(publishing, asset_loader):
    """A page of that node."""
    context, topics = publishing
    page, node = Page(port=8490), rclpy.create_node("physkin_view", context=context)
    drawn = RosPage(page, node, body=asset_loader.avatar(BUNDLED_AVATAR))
    yield drawn, topics, page
    drawn.close()
    node.destroy_node()
    page.server.stop()


def until(drawn, true, again=lambda: None):
    """Tick, and say what was raised."""
    end, told = time.monotonic() + 20, []
    while not true(told):
        assert time.monotonic() < end, told
        again()
        try:
            drawn.tick(0.1)
        except ValueError as error:
            told.append(str(error))
    return told


def test_clouds_and_mesh_are_drawn(shown):
    """A cloud as a surface once its mesh is known, the body in the pose of the joint states, faults as an error."""
    drawn, topics, _ = shown
    model = load_garment_model("skirt")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    cloud = GarmentCloud(draper.vertex_count, "root")
    draper.drape(model.rig.rest, out=cloud.points)
    joints = JointState(name=["spine03_x"], position=[0.15])
    surface = lambda: getattr(drawn.garments.get("/drape_node/garment"), "surface", None)  # noqa: E731

    def send():
        cloud.publish(topics["cloud"], 1, 2)
        topics["joints"].publish(joints)

    garment = lambda: drawn.garments.get("/drape_node/garment")  # noqa: E731
    until(drawn, lambda _: garment() and garment().drawn, send)
    assert surface() is None, "points until its mesh is known"
    topics["mesh"].publish(garment_mesh(draper.outfit, 0, "root"))
    until(drawn, lambda _: isinstance(surface(), SurfaceNode), send)
    np.testing.assert_array_equal(drawn.garments["/drape_node/garment"].points, cloud.points)
    until(drawn, lambda _: drawn.bodies["/joint_states"].positions, send)
    assert drawn.bodies["/joint_states"].positions == {"spine03_x": pytest.approx(0.15)}
    drawn.tick(0.1)
    assert drawn.bodies["/joint_states"].frame_id == "root"
    (told,) = until(drawn, len, lambda: topics["cloud"].publish(PointCloud2()))
    assert told.startswith("/drape_node/garment: no garment cloud")
    drawn.tick(0.1)


def test_figures_stand_where_tf_says(shown):
    """In the world that TF is of, seen from their middle; bodies in the frame of the clouds that bear their name; what
    TF does not know stands in a row."""
    pytest.importorskip("tf2_msgs", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")
    drawn, _, page = shown
    garments = {}
    for avatar in ("alice", "bob", "carol", "dan"):
        garments[avatar] = drawn.add_garment(f"/drape_node/{avatar}/top/garment")
        garments[avatar].points, garments[avatar].frame_id = np.zeros((3, 6), dtype=np.float32), f"{avatar}_root"
    bodies = {who: drawn.add_body(f"/{who}/joint_states") for who in ("alice", "bob")}
    for body in bodies.values():
        body.positions = {"spine03_x": 0.1}
    drawn.tick(0.1)
    rows = [garment.place.position.tolist() for garment in garments.values()]
    np.testing.assert_allclose(rows, [(0, y, 0.95) for y in (-1.8, -0.6, 0.6, 1.8)])
    turn = (0.0, 0.0, 0.6, 0.8)
    drawn.tree.update([transform("map", "alice_root", place=(3, 1, 1))])
    drawn.tree.update([transform("map", "bob_root", place=(5, 1, 1), quaternion=turn)], static=True)
    drawn.tick(0.1)
    for who, place in (("alice", (3, 1, 1)), ("bob", (5, 1, 1))):
        assert tuple(garments[who].place.position) == tuple(bodies[who].place.position) == place
    np.testing.assert_allclose(garments["bob"].place.wxyz, (0.8, 0, 0, 0.6))
    assert garments["carol"].place.position.tolist() == pytest.approx([0, -0.6, 0.95])
    assert page.world.position.tolist() == [-4, -1, 0]
    drawn.tree.update([transform("map", "alice_root", seconds=2.0, place=(4, 1, 1))])
    drawn.tick(0.1)
    assert garments["alice"].place.position.tolist() == [4, 1, 1]
    assert page.world.position.tolist() == [-4.5, -1, 0]


def test_hostile_meshes_and_names_end_nothing(shown):
    """Each is told, and one of an earlier version, which ends early; mesh and pose that were known stay, and the
    next cloud is drawn."""
    from physkin_msgs.msg import GarmentMesh

    drawn, topics, _ = shown
    until(drawn, lambda _: {"/drape_node/garment"} <= set(drawn.garments) and {"/joint_states"} <= set(drawn.bodies))
    until(drawn, lambda _: topics["mesh"].get_subscription_count())
    seen = drawn.garments["/drape_node/garment"]
    for fields, told in (
        ({"faces": [0, 1, 2, 3]}, "has 4 indices of faces; allowed: three for each"),
        ({"faces": [0, 1, 9]}, "has face index 9 of 9 vertices"),
        ({"layer": 9}, "is layer 9 of 1; allowed: 0 to 3, of up to 4"),
        ({"layers": 2**32 - 1}, "is layer 0 of 4294967295"),
    ):
        mesh = GarmentMesh(**({"faces": [0, 1, 2], "vertex_count": 9, "layers": 1} | fields), model_name="\x1b[2J" * 99)
        topics["mesh"].publish(mesh)
        found = until(drawn, lambda found, told=told: any(told in each for each in found))
        assert found[-1].isprintable() and len(found[-1]) < 250
    seen.faces, seen.layer, seen.layers = None, 0, 1
    topics["mesh"].publish(serialize_message(GarmentMesh(faces=[0, 1, 2], vertex_count=9, layers=1))[:-12])
    until(drawn, lambda found: "no GarmentMesh as physkin_msgs has it here" in " ".join(found))
    assert seen.faces is None and (seen.layer, seen.layers) == (0, 1)
    body = drawn.bodies["/joint_states"]

    def move():
        names = ["spine03_x", *(f"x{n}" for n in range(99))]
        topics["joints"].publish(JointState(name=names, position=[0.08] * len(names)))

    until(drawn, lambda _: body.positions == {"spine03_x": pytest.approx(0.08)}, move)
    cloud = GarmentCloud(9, "root" * 1000)
    told = until(drawn, len, lambda: cloud.publish(topics["cloud"], 1, 2))
    assert "has more than 256 characters" in told[-1]


def test_a_callback_that_fails_ends_itself_alone(shown, monkeypatch):
    """It is told, and others are served on."""
    drawn, topics, _ = shown
    monkeypatch.setattr("physkin_ros.tools.view.read_cloud", lambda _: 1 / 0)
    cloud, joints = GarmentCloud(9, "root"), JointState(name=["spine03_x"], position=[0.3])

    def send():
        cloud.publish(topics["cloud"], 1, 2)
        topics["joints"].publish(joints)

    moved = lambda: getattr(drawn.bodies.get("/joint_states"), "positions", {}).get("spine03_x", 0) > 0.2  # noqa: E731
    told = until(drawn, lambda told: "Zero" in " ".join(told) and moved(), send)
    assert "ZeroDivisionError: division by zero" in " ".join(told)


def test_the_core_reaches_it_by_name():
    """It may not import it."""
    from physkin_core.view.view import ROS_PAGE

    assert (Path(__file__).parents[3] / (ROS_PAGE.replace(".", "/") + ".py")).is_file()
