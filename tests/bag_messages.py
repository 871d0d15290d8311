"""Messages as `rosbags` has them, and everything that a bag holds."""

from __future__ import annotations

import numpy as np
from rosbags.rosbag2 import Reader

from physkin_ros.replay.bags import GRAVITY, JOINT_STATE, TYPES

TIME, HEADER, VECTOR3 = (
    TYPES.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Vector3")
)


def recorded(path):
    """Topic, time [ns] and message of everything in a bag."""
    with Reader(path) as reader:
        return [
            (connection.topic, time_ns, TYPES.deserialize_cdr(data, connection.msgtype))
            for connection, time_ns, data in reader.messages()
        ]


def joint_state(names, positions, seconds=1):
    nothing, header = np.zeros(0), HEADER(TIME(seconds, 0), "torso")
    return TYPES.types[JOINT_STATE](header, list(names), np.array(positions, dtype=np.float64), nothing, nothing)


def gravity(x, y, z):
    return TYPES.types[GRAVITY](HEADER(TIME(0, 0), ""), VECTOR3(float(x), float(y), float(z)))
