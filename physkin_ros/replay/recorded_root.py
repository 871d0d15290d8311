"""What a garment is told of the root beside the pose, from a bag's messages, as the ROS node tells it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core import UPRIGHT_GRAVITY, Draper
from physkin_core.motion.bag_reader import Recorded, decode
from physkin_ros.root.garment_gravity import GarmentGravity
from physkin_ros.root.gravity import Felt, unit_direction
from physkin_ros.root.imu_acceleration import USUAL_DELAY
from physkin_ros.root.root_orientation import RootOrientation, stamp_of
from physkin_ros.root.transform_tree import TransformTree

__all__ = ["RecordedRoot"]


class RecordedRoot:
    """Of one garment. Time is that of recording where the node takes its own clock's.

    orientation, frame_id, world_frame: as the node's parameters. gravity: (3,) direction in the root frame until a
    message tells another. sway: how much cloth swings, 0 to 1. down: unit direction (3,) that goes with the last joint
    state. fault: why TF does not say where the root is, "" where it does or is not asked.
    """

    def __init__(
        self,
        orientation: str = "gravity",
        *,
        gravity: Sequence[float] = UPRIGHT_GRAVITY,
        sway: float = 1.0,
        frame_id: str = "base_link",
        world_frame: str = "world",
    ) -> None:
        self.orientation, self.sway = orientation, sway
        self._frames = frame_id, world_frame
        self.down = unit_direction(gravity)
        self._told = GarmentGravity(self.down, (sway,))
        root = RootOrientation(self._told.add_direction, self._feel, sways=(sway,), imu_delay=USUAL_DELAY)
        self._takers = {"gravity": root.direction, "pose": root.pose, "odometry": root.odometry, "imu": root.imu}
        self._root, self._tree = root, TransformTree()
        if orientation == "tf":
            root.fault = f"no transform to {frame_id!r} has come"
        self._learnt = np.zeros(1, dtype=bool)
        self._now_ns = 0

    @property
    def fault(self) -> str:
        return self._root.fault

    def row(self, draper: Draper) -> np.ndarray:
        """(14,) float32, what `Draper.bind_step` reads; changed in place by `tell`."""
        self._learnt[:] = bool(draper.bound.sway_layers)
        return self._told.felt[0]

    def take(self, message: Recorded) -> None:
        """Take a message about the root. Raises ValueError for one that cannot be; what was known then goes on."""
        self._now_ns = message.time_ns
        if message.kind != "transforms":
            self._takers[message.kind](decode(message))
            return
        wrong = self._tree.update(decode(message).transforms, static=message.topic == "/tf_static")
        if reasons := self._root.transforms(self._tree, wrong, *self._frames):
            raise ValueError("; ".join(reasons))

    def tell(self, state, time_ns: int) -> None:
        """Set the row for a `sensor_msgs/JointState`, recorded at time_ns."""
        stamp, stamp_ns = state.header.stamp, stamp_of(state)
        if not self._told.take_felt(stamp_ns, time_ns, self._learnt):
            if self.fault:
                self._told.take_direction(None)
            else:
                self._told.take_by_stamp(stamp_ns)
        self._told.begin_frame(stamp.sec, stamp.nanosec)
        self.down = self._told.direction(stamp_ns)

    def _feel(self, felt: Felt, stamp_ns: int) -> None:
        self._told.add_felt(felt, stamp_ns, self._now_ns)
