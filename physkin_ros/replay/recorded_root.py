"""How the root moves by a bag's messages, and what a garment's frames are given by that, as in the ROS node."""

from __future__ import annotations

from physkin_core import UPRIGHT_GRAVITY, FrameInput
from physkin_core.motion.bag_reader import Recorded, decode
from physkin_ros.root.root_state import RootState, stamp_of
from physkin_ros.root.transform_tree import TransformTree

__all__ = ["RecordedRoot"]


class RecordedRoot:
    """Of one garment. Time is that of recording where the node takes its own clock's.

    orientation, frame_id, world_frame: as the node's parameters. sway: how much cloth swings, 0 to 1. rows: (1, 13)
    float32, what `Outfit.bind_frame` reads for an outfit of one garment; changed in place by `begin_frame`. down: unit
    direction (3,) that goes with the last joint state, upright until a message says another.
    """

    def __init__(
        self,
        orientation: str = "gravity",
        *,
        sway: float = 1.0,
        frame_id: str = "base_link",
        world_frame: str = "world",
    ) -> None:
        self.orientation, self.sway = orientation, sway
        self._frames, self._now_ns = (frame_id, world_frame), 0
        frame_input = FrameInput(1)
        frame_input.sway, self.rows = (sway,), frame_input.rows
        self._root = root = RootState(UPRIGHT_GRAVITY, frame_input, clock=lambda: self._now_ns)
        self.down = root.direction(0)
        self._takers = {
            "gravity": root.on_direction,
            "pose": root.on_pose,
            "odometry": root.on_odometry,
            "imu": root.on_imu,
        }
        self._tree = TransformTree()
        if orientation == "tf":
            root.fault = f"no transform to {frame_id!r} has come"

    @property
    def fault(self) -> str:
        """Why TF does not say where the root is, "" where it does or is not asked."""
        return self._root.fault

    def take(self, message: Recorded) -> None:
        """Take a message about the root. Raises ValueError for one that cannot be; what was known then goes on."""
        self._now_ns = message.time_ns
        if message.kind != "transforms":
            self._takers[message.kind](decode(message))
            return
        wrong = self._tree.update(decode(message).transforms, static=message.topic == "/tf_static")
        if reasons := self._root.on_transforms(self._tree, wrong, *self._frames):
            raise ValueError("; ".join(reasons))

    def begin_frame(self, state, time_ns: int) -> None:
        """Set the rows for a `sensor_msgs/JointState`, recorded at time_ns."""
        stamp, stamp_ns, self._now_ns = state.header.stamp, stamp_of(state), time_ns
        self._root.take(stamp_ns)
        self._root.begin_frame(stamp.sec, stamp.nanosec)
        self.down = self._root.direction(stamp_ns)
