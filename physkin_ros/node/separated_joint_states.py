"""The topic that tells which joint positions an avatar was draped in, once its limbs are separated."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import JointState

from physkin_ros.messages.topics import DRAPED_JOINT_STATES
from physkin_ros.middleware.quality_of_service import stream_quality

__all__ = ["SeparatedJointStates"]


class SeparatedJointStates:
    """Publishes `sensor_msgs/JointState` of an avatar, by id, for whoever draws the body. frame_id: its root's."""

    def __init__(self, node, avatar: str, frame_id: str) -> None:
        self._node = node
        self._publisher = node.create_publisher(JointState, DRAPED_JOINT_STATES.of(avatar), **stream_quality())
        self._names: Sequence[str] = ()
        self._message = JointState()
        self._message.header.frame_id = frame_id

    def publish(self, joint_names: Sequence[str], positions: np.ndarray, sec: int, nanosec: int) -> None:
        """Publish positions (d,) [rad] of the rig's joints (d,), with the stamp of the joint state that came in."""
        message = self._message
        if joint_names is not self._names:  # of another rig
            self._names, message.name = joint_names, list(joint_names)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        message.position = array("d", positions.astype(np.float64).tobytes())
        self._publisher.publish(message)

    def close(self) -> None:
        """Take the topic down."""
        self._node.destroy_publisher(self._publisher)
