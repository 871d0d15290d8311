"""Where a clip's root is in the world, as TF and as odometry for bags (extra `[replay]`).

Dimensions: `T` frames. Metres, seconds, radians.
"""

from __future__ import annotations

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Point as Point
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PoseWithCovariance as PoseWithCovariance
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Quaternion as Quaternion
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Transform as Transform
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__TransformStamped as TransformStamped
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Twist as Twist
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__TwistWithCovariance as TwistWithCovariance
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__Odometry as Odometry
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Header as Header
from rosbags.typesys.stores.ros2_jazzy import tf2_msgs__msg__TFMessage as TFMessage
from scipy.spatial.transform import Rotation

from physkin_core import Motion

__all__ = ["RootMessages"]

UNKNOWN = np.zeros(36)
"""Covariance that nobody has measured, as ROS marks it."""


class RootMessages:
    """Messages about a clip's root, frame by frame. frame_id: TF frame of the root; world_frame: of the world."""

    def __init__(self, motion: Motion, *, frame_id: str, world_frame: str) -> None:
        self._frame_id, self._world_frame = frame_id, world_frame
        self._places = motion.root_position.astype(np.float64)
        turns = Rotation.from_quat(motion.root_orientation)
        self._turns = turns.as_quat()
        self._velocities, self._spins = np.zeros((2, motion.frame_count, 3))
        if motion.frame_count > 1:
            self._velocities = turns.inv().apply(np.gradient(self._places, axis=0) * motion.rate_hz)
            steps = (turns[:-1].inv() * turns[1:]).as_rotvec() * motion.rate_hz
            self._spins = np.concatenate([steps[:1], (steps[:-1] + steps[1:]) / 2, steps[-1:]])

    def transforms(self, frame: int, stamp: Time) -> TFMessage:
        """World to root, for /tf."""
        transform = Transform(Vector3(*self._places[frame].tolist()), Quaternion(*self._turns[frame].tolist()))
        return TFMessage([TransformStamped(Header(stamp, self._world_frame), self._frame_id, transform)])

    def odometry(self, frame: int, stamp: Time) -> Odometry:
        """The same as a pose, and how fast the root moves and turns, seen from itself."""
        pose = Pose(Point(*self._places[frame].tolist()), Quaternion(*self._turns[frame].tolist()))
        twist = Twist(Vector3(*self._velocities[frame].tolist()), Vector3(*self._spins[frame].tolist()))
        header = Header(stamp, self._world_frame)
        return Odometry(header, self._frame_id, PoseWithCovariance(pose, UNKNOWN), TwistWithCovariance(twist, UNKNOWN))
