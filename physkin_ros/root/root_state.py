"""What messages say of an avatar's root: where it is, how it moves, where down is; and what goes with a joint state.

Messages are those of ROS or, from bags, those of `rosbags`, which have the same fields. Stamps are in ns, 0 for none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from time import monotonic_ns

import numpy as np

from physkin_core import FrameInput
from physkin_core.runtime.frame_input import RootSample, RootTracker, unit_direction
from physkin_ros.messages.conversions import gravity_direction
from physkin_ros.root.gravity import (
    SAME_CLOCK,
    EffectiveGravity,
    FreshByStamp,
    LatestByStamp,
    gravity_from_imu,
    gravity_from_quaternion,
)
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

__all__ = ["RootState", "stamp_of"]


def stamp_of(message) -> int:
    """The stamp [ns] of a message's header."""
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class RootState:
    """Of one avatar. Messages that cannot be raise ValueError; what was known last then goes on.

    down: direction of gravity (3,), of any length but zero, in the root frame until another one comes. clock: gives the
    time [ns] by which messages are fresh.
    frame_input: of the avatar's garments. Nobody else writes its rows: `take` and `begin_frame` do, by how the root
    moves as far as that is known and fresh, or else by where down is.
    fault: why TF does not say where the root is, "" where it does or is not asked.
    """

    def __init__(
        self, down: Sequence[float] | np.ndarray, frame_input: FrameInput, *, clock: Callable[[], int] = monotonic_ns
    ) -> None:
        self.frame_input, self.fault = frame_input, ""
        self._gravity = frame_input.rows[:, :3]
        self._clock = clock
        self._directions = LatestByStamp(_float32(down))
        self._motions: FreshByStamp[RootSample | EffectiveGravity] = FreshByStamp()
        self._taken: RootSample | EffectiveGravity | np.ndarray = self.direction(0)
        self._tracker: RootTracker | None = RootTracker()
        self._last_ns = 0
        self._acceleration = ImuAcceleration()

    # Messages.

    def set_direction(self, down: Sequence[float] | np.ndarray) -> None:
        """Another direction of gravity (3,), of any length but zero, as of now."""
        self._directions.add(_float32(down), 0)

    def on_direction(self, message) -> None:
        """Take a `geometry_msgs/Vector3Stamped`: gravity's direction in the root frame."""
        self._directions.add(_float32(gravity_direction(list(vector_of(message.vector)))), stamp_of(message))

    def on_pose(self, message) -> None:
        """Take a `geometry_msgs/PoseStamped` of the root in an upright frame."""
        self._place(stamp_of(message), vector_of(message.pose.position), quaternion_of(message.pose.orientation))

    def on_odometry(self, message) -> None:
        """The same of a `nav_msgs/Odometry`; its twist is not read."""
        pose = message.pose.pose
        self._place(stamp_of(message), vector_of(pose.position), quaternion_of(pose.orientation))

    def on_imu(self, message) -> None:
        """Take a `sensor_msgs/Imu` at the root."""
        stamp_ns = stamp_of(message)
        felt = self._acceleration.effective_gravity(message, stamp_ns)
        self._directions.add(gravity_from_imu(message).astype(np.float32), stamp_ns)
        if felt is not None:
            self._motions.add(felt, stamp_ns, self._clock())

    def on_transforms(
        self, tree: TransformTree, wrong: Mapping[str, str], frame_id: str, world_frame: str
    ) -> list[str]:
        """Take TF when something in it has changed: where frame_id is in world_frame, which is upright; or set `fault`.

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

    def still(self) -> None:
        """Let the root's motion count no more, only gravity's direction."""
        self._tracker = None

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
            self._motions.add(sample, stamp_ns, self._clock())
        self._directions.add(gravity_from_quaternion(turn).astype(np.float32), stamp_ns)

    # Frames.

    def direction(self, stamp_ns: int) -> np.ndarray:
        """Gravity's unit direction (3,) float32 that goes with a joint state, however the root is accelerated."""
        return self._directions.at(stamp_ns)

    def motion(self, stamp_ns: int = 0) -> RootSample | EffectiveGravity | None:
        """How the root moves at a joint state, by default by the latest message; None where nothing is fresh."""
        return self._motions.at(stamp_ns, self._clock())

    def take(self, stamp_ns: int) -> np.ndarray:
        """Find what goes with a joint state. Returns the gravity (g, 3) that it gives the garments, wind apart."""
        known = self.motion(stamp_ns)
        self._taken = self.direction(stamp_ns) if known is None else known
        self._fill()
        return self._gravity

    def begin_frame(self, sec: int, nanosec: int, gravity: np.ndarray | None = None) -> None:
        """Begin the frame of a joint state with this stamp; 0 for none: it then stands by itself.

        gravity: (g, 3) in place of what `take` has found.
        """
        if gravity is not None:
            self._fill()
            self._gravity[:] = gravity
        self.frame_input.begin_frame(sec + 1e-9 * nanosec if sec or nanosec else None)

    def _fill(self) -> None:
        if isinstance(self._taken, EffectiveGravity):
            self.frame_input.set_effective_gravity(self._taken.vector, self._taken.at_rest)
        elif isinstance(self._taken, np.ndarray):
            self.frame_input.set_gravity(self._taken)
        else:
            self.frame_input.set_root_sample(self._taken)


def _float32(down: Sequence[float] | np.ndarray) -> np.ndarray:
    """Its unit direction, as networks know it."""
    return unit_direction(np.asarray(down)).astype(np.float32)
