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
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model  # noqa: E402
from physkin_core.view.page import Page  # noqa: E402
from physkin_core.view.surface_node import SurfaceNode  # noqa: E402
from physkin_ros.messages.conversions import GarmentCloud, garment_mesh  # noqa: E402
from physkin_ros.tools.view import CloudListener, RosPage  # noqa: E402


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
        "joints": other.create_publisher(JointState, "joint_states", 1),
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


def test_clouds_and_mesh_are_drawn(listening):
    """A cloud as a surface once its mesh is known, the body in the pose of the joint states, faults as an error."""
    listener, topics = listening
    model = load_garment_model("skirt")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    cloud = GarmentCloud(draper.vertex_count, "root")
    draper.drape(model.rig.rest, out=cloud.points)
    joints = JointState(name=["spine03_x"], position=[0.15])
    page = Page(port=8490)
    try:
        drawn = RosPage(page, listener, body=str(BUNDLED_AVATAR))
        seen = lambda: listener.garments.get("/drape_node/garment")  # noqa: E731

        def send():
            cloud.publish(topics["cloud"], 1, 2)
            topics["joints"].publish(joints)

        until(lambda: seen() and seen().points is not None and listener.joint_positions, send)
        drawn.tick(1.0)
        assert not isinstance(drawn._cloths["/drape_node/garment"][0], SurfaceNode)
        topics["mesh"].publish(garment_mesh(draper, "root"))
        until(lambda: seen().faces is not None, send)
        seen().clouds += 1
        drawn.tick(0.1)
        assert isinstance(drawn._cloths["/drape_node/garment"][0], SurfaceNode)
        np.testing.assert_array_equal(seen().points, cloud.points)
        assert listener.joint_positions == {"spine03_x": pytest.approx(0.15)}
        topics["cloud"].publish(PointCloud2())
        until(lambda: seen().fault)
        with pytest.raises(ValueError, match="/drape_node/garment: no garment cloud"):
            drawn.tick(0.1)
        drawn.tick(0.1)
    finally:
        page.server.stop()


def test_the_core_reaches_it_by_name():
    """It may not import it."""
    from physkin_core.view.command import ROS_PAGE

    assert (Path(__file__).parents[3] / (ROS_PAGE.replace(".", "/") + ".py")).is_file()
