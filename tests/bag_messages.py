"""Messages as `rosbags` has them, and everything that a bag holds."""

from __future__ import annotations

import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3Stamped as Vector3Stamped
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__JointState as JointState
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Header as Header

from physkin_core.motion.bag_reader import JOINT_STATE, TYPES
from physkin_ros.replay.bags import BagWriter


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


def write_bag(path, *, storage="mcap", count=5, pause=0):
    """A bag of joint states of a hip 20 ms apart, the last after a pause of so many steps."""
    with BagWriter(path, storage=storage) as writer:
        for k in range(count):
            time_ns = 10**9 + (k + (k == count - 1) * pause) * 20_000_000
            message = joint_state(["hip"], [0.1 * k])
            message.header.stamp = Time(*divmod(time_ns, 10**9))
            writer.write("/joint_states", JOINT_STATE, message, time_ns)
    return path
