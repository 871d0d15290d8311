"""Messages as `rosbags` has them, and everything that a bag holds."""

from __future__ import annotations

import numpy as np
from rosbags.rosbag2 import Reader

from physkin_core.motion.bag_reader import TYPES
from physkin_ros.replay.bags import Header, JointState, Time, Vector3, Vector3Stamped


def recorded(path):
    """Topic, time [ns] and message of everything in a bag."""
    with Reader(path) as reader:
        return [
            (connection.topic, time_ns, TYPES.deserialize_cdr(data, connection.msgtype))
            for connection, time_ns, data in reader.messages()
        ]


def joint_state(names, positions):
    return JointState(Header(Time(1, 0), "torso"), list(names), np.array(positions, float), np.zeros(0), np.zeros(0))


def gravity(x, y, z):
    return Vector3Stamped(Header(Time(0, 0), ""), Vector3(float(x), float(y), float(z)))
