"""A drape node that is sent rotations of bones: the clouds of the joint positions that they come from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from geometry_msgs.msg import Quaternion, Transform  # noqa: E402
from sensor_msgs.msg import MultiDOFJointState  # noqa: E402


@pytest.fixture(scope="module")
def send(running_node, module_peer, model_path):
    """Publishes rotations by bone; waits for the node at first."""
    publisher = module_peer.node.create_publisher(MultiDOFJointState, "bone_rotations", 10)

    def publish(rotations, stamp) -> None:
        turns = [Transform(rotation=Quaternion(x=x, y=y, z=z, w=w)) for x, y, z, w in rotations.values()]
        message = MultiDOFJointState(joint_names=list(rotations), transforms=turns)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        publisher.publish(message)

    with running_node({"model": str(model_path)}):
        module_peer.until(publisher.get_subscription_count, "subscription to bone_rotations")
        module_peer.spin(0.2)
        yield publish


def rotations_of(rig, positions):
    """Quaternion (x, y, z, w) of each bone that joint positions (d,) turn."""
    turns = {}
    for dof, axis, value in zip(rig.dofs, rig.dof_axes, np.asarray(positions, dtype=np.float64)):
        turn = Rotation.from_rotvec(axis * (value - dof.rest))
        turns[dof.bone] = turns[dof.bone] * turn if dof.bone in turns else turn
    return {bone: turn.as_quat().tolist() for bone, turn in turns.items()}


def test_clouds_are_those_of_joint_positions(peer, send, draper):
    """To the bit; joint states and bone rotations may take turns, and what one leaves out the other has set."""
    rig = draper.model.rig
    pose = np.random.default_rng(2).uniform(rig.lower, rig.upper).astype(np.float32)
    send(rotations_of(rig, pose), (1, 0))
    peer.until(lambda: (1, 0) in peer.clouds, "cloud")
    np.testing.assert_array_equal(peer.clouds[1, 0], draper.drape(pose))
    pose[0] = 0.05
    np.testing.assert_array_equal(peer.cloud(rig.joint_names[:1], pose[:1], (2, 0)), draper.drape(pose))


def test_bad_rotations_leave_the_last_good_pose(peer, send, draper):
    """They are counted as rejected, with the reason."""
    rest = draper.model.rig.rest.astype(np.float32)
    peer.cloud(draper.joint_names, rest, (3, 0))
    peer.until(lambda: peer.reports, "diagnostics")
    before = int(peer.latest("joint states rejected"))
    send({"head": [0.0, 0.0, 0.0, 2.0]}, (4, 0))
    peer.until_told("joint states rejected", str(before + 1))
    assert "rotation of bone 'head'" in peer.latest("last rejection")
    assert (4, 0) not in peer.clouds
    np.testing.assert_array_equal(peer.cloud(draper.joint_names[:1], rest[:1], (5, 0)), draper.drape(rest))
