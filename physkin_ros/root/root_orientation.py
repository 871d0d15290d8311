"""Where down is, and what garments feel, from what messages say of the root: of topics, and of bags alike.

Messages are those of ROS or of `rosbags`, which have the same fields. Stamps are in ns, 0 for none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from physkin_core.sway.frame_input import RootSample, RootTracker, unit_direction
from physkin_ros.messages.conversions import gravity_direction
from physkin_ros.root.gravity import SAME_CLOCK, EffectiveGravity, gravity_from_imu, gravity_from_quaternion
from physkin_ros.root.imu_acceleration import ImuAcceleration
from physkin_ros.root.quaternions import (
    OrientationError,
    Quaternion,
    Vector,
    quaternion_of,
    unit_quaternion,
    vector_of,
)
from physkin_ros.root.transform_tree import TransformTree

__all__ = ["DirectionTaker", "MotionTaker", "RootOrientation", "stamp_of"]

DirectionTaker = Callable[[np.ndarray, int], None]
MotionTaker = Callable[[RootSample | EffectiveGravity, int], None]
"""Take what a message says and its stamp [ns]; directions are float32."""


def stamp_of(message) -> int:
    """The stamp [ns] of a message's header."""
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class RootOrientation:
    """Calls back with what messages say, and their stamps.

    on_direction: takes gravity's unit direction (3,). on_motion: takes how the root moves, or what its IMU measures.
    fault: why TF does not say where the root is, "" where it does or is not asked.
    Messages that cannot be raise ValueError; what was known last then goes on.
    """

    def __init__(self, on_direction: DirectionTaker, on_motion: MotionTaker) -> None:
        self.fault = ""
        self._on_direction, self._on_motion = on_direction, on_motion
        self._tracker: RootTracker | None = RootTracker()
        self._last_ns = 0
        self._acceleration = ImuAcceleration()

    def still(self) -> None:
        """Let the root's motion count no more, only gravity's direction."""
        self._tracker = None

    def direction(self, message) -> None:
        """Of a `geometry_msgs/Vector3Stamped`: gravity's direction in the root frame."""
        down = gravity_direction(list(vector_of(message.vector)))
        self._tell_direction(unit_direction(down), stamp_of(message))

    def pose(self, message) -> None:
        """Of a `geometry_msgs/PoseStamped` of the root in an upright frame."""
        self._place(stamp_of(message), vector_of(message.pose.position), quaternion_of(message.pose.orientation))

    def odometry(self, message) -> None:
        """The same of a `nav_msgs/Odometry`; its twist is not read."""
        pose = message.pose.pose
        self._place(stamp_of(message), vector_of(pose.position), quaternion_of(pose.orientation))

    def imu(self, message) -> None:
        """Of a `sensor_msgs/Imu` at the root."""
        stamp_ns = stamp_of(message)
        effective_gravity = self._acceleration.effective_gravity(message, stamp_ns)
        self._tell_direction(gravity_from_imu(message), stamp_ns)
        if effective_gravity is not None:
            self._on_motion(effective_gravity, stamp_ns)

    def transforms(self, tree: TransformTree, wrong: Mapping[str, str], frame_id: str, world_frame: str) -> list[str]:
        """Of TF, when something in it has changed: where frame_id is in world_frame, which is upright; or sets `fault`.

        wrong: of `TransformTree.update`. Returns what of that is about frames between these two.
        """
        try:
            stamp_ns, place, turn = tree.pose(frame_id, world_frame)
            if self._follows(stamp_ns):
                self._place(stamp_ns, place, turn)
        except ValueError as error:
            self.fault = str(error)
            return []
        self.fault = ""
        return [wrong[frame] for frame in wrong.keys() & tree.chain(frame_id, world_frame)] if wrong else []

    def _follows(self, stamp_ns: int) -> bool:
        """Whether a pose of this stamp comes after the last; a clock that begins anew, or no stamp, does, too."""
        return not stamp_ns or not 0 <= self._last_ns - stamp_ns <= SAME_CLOCK

    def _place(self, stamp_ns: int, place: Vector, turn: Quaternion) -> None:
        """The root is at `place` [m] in an upright frame, turned by a quaternion (x, y, z, w), root to that frame."""
        turn = unit_quaternion(turn)
        if not all(map(math.isfinite, place)):
            raise OrientationError(f"the root's position is {list(place)}; it must be finite [m]")
        if stamp_ns != self._last_ns and not self._follows(stamp_ns):
            raise OrientationError(f"the root's pose is stamped {1e-9 * (self._last_ns - stamp_ns):.3f} s back")
        self._last_ns = stamp_ns
        if self._tracker is not None and stamp_ns:
            sample = self._tracker.move(1e-9 * stamp_ns, np.array((*place, *turn), dtype=np.float64))
            self._on_motion(sample, stamp_ns)
        self._tell_direction(gravity_from_quaternion(turn), stamp_ns)

    def _tell_direction(self, down: np.ndarray, stamp_ns: int) -> None:
        self._on_direction(down.astype(np.float32), stamp_ns)
