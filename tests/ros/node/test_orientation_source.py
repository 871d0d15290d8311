"""What an orientation source makes of messages; and drape nodes of which cloth remembers the frame before."""

from __future__ import annotations

import sys
from types import SimpleNamespace as Message
from unittest.mock import patch

import numpy as np
import pytest
from avatar_settings import avatar_settings
from root_messages import imu, odometry, transform
from scipy.spatial.transform import Rotation

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from geometry_msgs.msg import Quaternion  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402

from physkin_core import BUNDLED_AVATAR, Draper, FrameInput, load_avatar, load_garment_model  # noqa: E402
from physkin_ros.node import orientation_source  # noqa: E402
from physkin_ros.node.orientation_source import OrientationSource, check_orientation  # noqa: E402
from physkin_ros.node.settings import SettingsError  # noqa: E402
from physkin_ros.root import tf_topics, transform_tree  # noqa: E402
from physkin_ros.root.root_state import RootState  # noqa: E402
from physkin_ros.root.tf_topics import FollowedTransforms  # noqa: E402

DOWN = np.array([0.0, 0.0, -1.0])


def needs_tf_messages():
    pytest.importorskip("tf2_msgs", reason="needs tf2_msgs: python msg_defs/wheel/build.py --install")


class Root(RootState):
    """rows: what a garment was given (13,) of each motion. gravity: each direction (3,)."""

    def __init__(self) -> None:
        self.rows, self.gravity = [], []
        super().__init__(DOWN, FrameInput(1))
        for kept, told in ((self._motions, self._on_motion), (self._directions, self._on_direction)):
            kept.add = self._watched(kept.add, told)

    def _watched(self, add, told):
        return lambda *given: (add(*given), told(*given))

    def _on_motion(self, motion, stamp, now) -> None:
        self.take(0)
        self.rows.append(self.frame_input.rows[0].copy())

    def _on_direction(self, down, stamp) -> None:
        self.gravity.append(down)


class Wired:
    """An orientation source without a node: what it is sent, and what it then says."""

    def __init__(self, **given):
        if given["orientation"] == "tf":
            needs_tf_messages()
        self.callbacks, self.bad, self.closed, self.root = {}, [], [], Root()
        self.rows, self.gravity = self.root.rows, self.root.gravity
        self.transforms = FollowedTransforms(None)
        with (
            patch.object(orientation_source, "FollowingSubscription", self._subscribe),
            patch.object(tf_topics, "FollowingSubscription", self._subscribe),
        ):
            self.source = OrientationSource(None, avatar_settings(**given), self.transforms, self.root, self.bad.append)

    def _subscribe(self, node, kind, topic, take, **how):
        """Stands in for a subscription that reads bytes."""
        self.callbacks[topic] = take
        return Message(close=lambda: self.closed.append(topic))

    @property
    def felt(self):
        return [row[:3] for row in self.rows]

    def send(self, topic: str, message):
        self.callbacks[topic](message)


def as_odometry(wired: Wired, seconds: float, place):
    wired.send("odometry", odometry(seconds, place))


def as_tf(wired: Wired, seconds: float, place):
    wired.send("/tf", Message(transforms=[transform("world", "root", seconds=seconds, place=place)]))


SOURCES = {"odometry": as_odometry, "tf": as_tf}


@pytest.mark.parametrize("kind", SOURCES)
def test_a_root_that_sets_off_is_followed(kind):
    """The same by odometry and TF."""
    wired, other = Wired(orientation=kind), Wired(orientation="odometry")
    for k in range(60):
        SOURCES[kind](wired, 1000 + k / 60, (1.5 * (k / 60) ** 2, 0, 0))
        as_odometry(other, 1000 + k / 60, (1.5 * (k / 60) ** 2, 0, 0))
    assert wired.felt[-1] == pytest.approx(DOWN)
    assert wired.rows[0][7:] == pytest.approx(np.zeros(6))
    assert wired.rows[-1][7] == pytest.approx(3 * 58.5 / 60, rel=1e-3)
    np.testing.assert_array_equal(wired.rows, other.rows)
    assert len(wired.gravity) == 60 and wired.gravity[-1] == pytest.approx(DOWN)
    assert wired.bad == [] and wired.root.fault == ""


def test_a_root_that_turns_is_followed():
    wired = Wired(orientation="odometry")
    for k in range(40):
        half = 0.05 * max(k - 5, 0)
        wired.send("odometry", odometry(1000 + k / 60, (0, 0, 0), (0.0, 0.0, np.sin(half), np.cos(half))))
    assert wired.rows[15][10:] == pytest.approx([0, 0, 6], rel=1e-3)


def test_an_imu_that_is_pushed_leans_cloth():
    wired = Wired(orientation="imu")
    for k in range(60):
        wired.send("imu", imu(1000 + k / 60, (3.0 if k else 0.0, 0, 9.81), (0.0, 0.0, 0.0, 1.0)))
    assert wired.felt[0] == pytest.approx(DOWN) and wired.felt[-1] == pytest.approx([-3 / 9.81, 0, -1], abs=1e-4)
    assert wired.gravity[-1] == pytest.approx(DOWN)
    wired.send("imu", imu(1002, (np.nan, 0, 9.81)))
    assert len(wired.bad) == 1 and len(wired.felt) == len(wired.gravity) == 60


def test_bad_poses_are_told():
    """And leave what was known."""
    wired = Wired(orientation="odometry")
    as_odometry(wired, 1.0, (0, 0, 0))
    for message in (
        odometry(1.1, (np.nan, 0, 0)),
        odometry(1.1, (0, 0, 0), (0.0, 0.0, 0.0, 0.0)),
        odometry(0.9, (0, 0, 0)),
    ):
        wired.send("odometry", message)
    assert ["finite" in wired.bad[0], "quaternion" in wired.bad[1], "0.100 s back" in wired.bad[2]] == [True] * 3
    assert len(wired.gravity) == 1


def test_tf_that_does_not_lead_there_is_told():
    """Until it does; a bad transform of these frames is told, one of others is not."""
    wired = Wired(orientation="tf")
    assert "no transform from 'world' to 'root'" in wired.root.fault
    as_tf(wired, 1.0, (0, 0, 0))
    assert wired.root.fault == "" and len(wired.gravity) == 1
    nowhere = {"place": (np.nan, 0, 0), "seconds": 1.1}
    wired.send("/tf", Message(transforms=[transform("world", "root", **nowhere), transform("a", "b", **nowhere)]))
    assert len(wired.bad) == 1 and "'world' to 'root'" in wired.bad[0]
    wired.send("/tf_static", Message(transforms=[transform("nowhere", "root")]))
    assert "nothing is known above 'nowhere'" in wired.root.fault
    wired.send("/tf_static", Message(transforms=[transform("world", "nowhere")]))
    assert wired.root.fault == ""
    assert len(wired.gravity) == 2 and wired.gravity[-1] == pytest.approx(DOWN)


def test_avatars_share_what_is_read_of_tf():
    """One that comes later knows all at once; the topics go with the last."""
    wired, told = Wired(orientation="tf"), Root()
    as_tf(wired, 1.0, (0, 0, 0))
    topics = len(wired.callbacks)
    other = avatar_settings(orientation="tf", id="other", frame_id="arm")
    wired.send("/tf_static", Message(transforms=[transform("root", "arm")]))
    source = OrientationSource(None, other, wired.transforms, told, wired.bad.append)
    assert len(told.gravity) == 1 and told.fault == ""
    assert len(wired.callbacks) == topics
    as_tf(wired, 2.0, (0, 0, 0))
    assert len(told.gravity) == 2 and len(wired.gravity) == 2
    tf = {"/tf", "/tf_static"}
    wired.source.close()
    assert not tf & set(wired.closed)
    source.close()
    assert tf <= set(wired.closed)


def test_frames_that_are_left_out_are_told_once(monkeypatch):
    monkeypatch.setattr(transform_tree, "MOST_FRAMES", 1)
    wired = Wired(orientation="tf")
    for k in range(3):
        as_tf(wired, 1.0 + k, (0, 0, 0))
        wired.send("/tf", Message(transforms=[transform("world", f"invented{k}")]))
    assert len(wired.bad) == 1 and "frames of TF are left out: 'invented0' and further ones" in wired.bad[0]
    assert len(wired.gravity) == 3


def test_what_tf_needs(monkeypatch):
    """Where its messages are not installed, the parameter is refused with what would do."""
    needs_tf_messages()
    check_orientation(avatar_settings(orientation="tf"))
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", None)
    with pytest.raises(SettingsError, match="parameter orientation.*tf2_msgs is not installed.*--install"):
        check_orientation(avatar_settings(orientation="tf"))


@pytest.mark.parametrize("orientation", ["odometry", "gravity"])
def test_a_sway_network_moves_cloth(orientation, peer, running_node, monkeypatch, swaying_model_path):
    """As that of a draper that is told time and root, or, where nobody tells the root, time alone."""
    model, moves, move = load_garment_model(swaying_model_path), [], RootState.on_odometry
    monkeypatch.setattr(RootState, "on_odometry", lambda *given: moves.append(given) or move(*given))
    draper, alone = (Draper(model, load_avatar(BUNDLED_AVATAR, model.rig), precision="fp32") for _ in range(2))
    names, joints, message, swung = model.rig.joint_names, model.rig.rest.astype(np.float32), Odometry(), 0.0
    parameters = {"model": str(swaying_model_path), "orientation": orientation, "precision": "fp32"}
    with running_node(parameters, gravity=False):
        publisher = peer.node.create_publisher(Odometry, "odometry", 50)
        if orientation == "odometry":
            peer.until(publisher.get_subscription_count, "subscription to odometry")
        for k in range(12):
            stamp = message.header.stamp.sec, message.header.stamp.nanosec = 7000, k * 25_000_000
            told, turn = {}, Rotation.from_euler("yz", (0.05 * k, 0.1 * k)).as_quat().tolist()
            if orientation == "odometry":
                message.pose.pose.orientation = Quaternion(**dict(zip("xyzw", turn)))
                message.pose.pose.position.x = 0.03 * k
                publisher.publish(message)
                peer.until(lambda k=k: len(moves) > k, "odometry")
                told = {"root": (0.03 * k, 0, 0, *turn)}
            joints += np.float32(0.02)
            cloud = peer.cloud(names, joints, stamp)
            np.testing.assert_allclose(cloud, draper.drape(joints, time=stamp[0] + 1e-9 * stamp[1], **told), atol=1e-4)
            down = Rotation.from_quat(turn).inv().apply(DOWN) if told else DOWN
            swung = max(swung, np.abs(cloud - alone.drape(joints, down))[:, :3].max())
        peer.node.destroy_publisher(publisher)
    assert swung > 0.005


def test_a_sway_network_moves_cloth_between_joint_states(peer, running_node, swaying_model_path):
    """Clouds at a rate of their own are those of a draper that is told their stamps, and the poses on the way."""
    model = load_garment_model(swaying_model_path)
    draper, alone = (Draper(model, load_avatar(BUNDLED_AVATAR, model.rig), precision="fp32") for _ in range(2))
    names, rest = model.rig.joint_names, model.rig.rest.astype(np.float32)
    parameters = {"model": str(swaying_model_path), "precision": "fp32", "cloud_rate": 100.0}
    with running_node(parameters):
        for k in range(4):
            peer.send(names, rest + np.float32(0.1 * k), (8000, 100_000_000 * k))
            peer.spin(0.1)
        peer.until(lambda: (8000, 300_000_000) in peer.clouds, "last cloud")
    swung, stamps = 0.0, sorted(peer.clouds)
    assert stamps[0] == (8000, 0) and len(stamps) > 10  # 30 where the machine is idle
    for sec, nanosec in stamps:
        pose = rest + np.float32(nanosec * 1e-9)
        expected = draper.drape(pose, time=sec + 1e-9 * nanosec)
        np.testing.assert_allclose(peer.clouds[sec, nanosec], expected, atol=1e-3)
        swung = max(swung, np.abs(expected - alone.drape(pose))[:, :3].max())
    assert swung > 0.005


@pytest.mark.parametrize("sway", [1.0, 0.0])
def test_cloth_keeps_its_pace_by_the_stamps(sway, peer, running_node):
    """As that of a draper that is told the time; without sway every joint state is draped by itself."""
    model = load_garment_model("tshirt")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig), precision="fp32")
    alone, draper.sway = draper.outfit.twin(), sway
    names, pose, late = model.rig.joint_names, model.rig.rest.astype(np.float32), 0.0
    with running_node({"model": "tshirt", "precision": "fp32", "sway": sway}):
        for k in range(4):
            pose[names.index("upperarm01.L_x")] += 0.3
            cloud = peer.cloud(names, pose, (6000, 2_000_000 * k))
            np.testing.assert_allclose(cloud, draper.drape(pose, time=6000 + 0.002 * k), atol=1e-5)
            late = max(late, np.abs(cloud - alone.drape(pose)[0])[:, :3].max())
    assert late > 0.01 if sway else late == 0
