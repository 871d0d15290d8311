"""Bags written without ROS: clouds and motion clips (extra `[replay]`). `physkin_core.motion.bag_reader` reads them."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys.stores import ros2_jazzy as ros
from scipy.spatial.transform import Rotation

from physkin_core import Motion
from physkin_core.motion.bag_reader import GRAVITY, JOINT_STATE, ODOMETRY, TRANSFORMS, TYPES, BagError, bag_errors
from physkin_ros.messages.conversions import CLOUD_FIELDS, FLOAT32

__all__ = ["BagWriter", "RootMessages", "write_motion"]

CLOUD = "sensor_msgs/msg/PointCloud2"
SINGLE_FILES = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}
METADATA_VERSION = 9  # of ROS 2 Jazzy
UNKNOWN = np.zeros(36)
"""Covariance that nobody has measured, as ROS marks it."""


class BagWriter:
    """Writes a bag (metadata version 9, ROS 2 Jazzy); of a `with` block that fails nothing is left.

    path: a folder to make, or a single file that ends in .mcap or .db3. storage: of a folder, "mcap" or "sqlite3".
    Raises BagError when `path` exists or cannot be written.
    """

    def __init__(self, path: str | Path, *, storage: str = "mcap") -> None:
        self.path = Path(path)
        self._plugin = SINGLE_FILES.get(self.path.suffix, StoragePlugin[storage.upper()])
        if self.path.exists():
            raise BagError(f"{self.path} exists already: choose another name, or remove it")
        if not self.path.parent.is_dir():
            raise BagError(f"cannot write {self.path}: there is no folder {self.path.parent}")
        self._connections: dict[str, object] = {}

    def __enter__(self) -> BagWriter:
        try:  # beside the target, so that nobody sees half a bag and the last step is a rename
            self._folder = Path(tempfile.mkdtemp(dir=self.path.parent, prefix=f".{self.path.name}-"))
        except OSError as error:
            raise BagError(f"cannot write {self.path}: {error.strerror}") from error
        with bag_errors(self.path):
            bag = self._folder / self.path.name
            self._writer = Writer(bag, version=METADATA_VERSION, storage_plugin=self._plugin)
            self._writer.open()
        return self

    def __exit__(self, kind, *exception) -> None:
        try:
            if kind is not None:
                self._writer.abort()
                return
            with bag_errors(self.path):
                self._writer.close()
                made = self._folder / self.path.name
                if self.path.suffix in SINGLE_FILES:
                    (made,) = made.glob(f"*{self.path.suffix}")
                made.rename(self.path)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def write(self, topic: str, kind: str, message, time_ns: int) -> None:
        """Write a `rosbags` message of type `kind` (such as `sensor_msgs/msg/JointState`)."""
        self.write_bytes(topic, kind, TYPES.serialize_cdr(message, kind), time_ns)

    def write_bytes(self, topic: str, kind: str, data: bytes, time_ns: int) -> None:
        """Write a message that is CDR bytes already, right or wrong."""
        with bag_errors(self.path):
            if topic not in self._connections:
                # no quality of service is named: players take their default, reliable
                self._connections[topic] = self._writer.add_connection(topic, kind, typestore=TYPES)
            self._writer.write(self._connections[topic], time_ns, data)

    def write_cloud(self, topic: str, points: np.ndarray, stamp, frame_id: str, time_ns: int) -> None:
        """Write a garment cloud, laid out as the node's. points: (n, 6) float32, position [m] and unit normal."""
        step, one = 4 * len(CLOUD_FIELDS), {"datatype": FLOAT32, "count": 1}
        message = ros.sensor_msgs__msg__PointCloud2(
            header=_header(1_000_000_000 * stamp.sec + stamp.nanosec, frame_id),
            height=1,
            width=len(points),
            fields=[
                ros.sensor_msgs__msg__PointField(name=name, offset=4 * i, **one) for i, name in enumerate(CLOUD_FIELDS)
            ],
            is_bigendian=sys.byteorder == "big",
            point_step=step,
            row_step=step * len(points),
            data=np.frombuffer(np.ascontiguousarray(points, dtype=np.float32).tobytes(), dtype=np.uint8),
            is_dense=bool(np.isfinite(points).all()),
        )
        self.write(topic, CLOUD, message, time_ns)


class RootMessages:
    """Where a clip's root is in the world, frame by frame. frame_id, world_frame: TF frames of both."""

    def __init__(self, motion: Motion, *, frame_id: str, world_frame: str) -> None:
        self._frame_id, self._world_frame = frame_id, world_frame
        self._places, turns = motion.root_position.astype(np.float64), Rotation.from_quat(motion.root_orientation)
        self._turns = turns.as_quat()
        self._velocities, self._spins = np.zeros((2, motion.frame_count, 3))
        if motion.frame_count > 1:
            self._velocities = turns.inv().apply(np.gradient(self._places, axis=0) * motion.rate_hz)
            steps = (turns[:-1].inv() * turns[1:]).as_rotvec() * motion.rate_hz
            self._spins = np.concatenate([steps[:1], (steps[:-1] + steps[1:]) / 2, steps[-1:]])

    def transforms(self, frame: int, time_ns: int):
        """World to root, for /tf."""
        transform = ros.geometry_msgs__msg__Transform(_vector(self._places[frame]), self._turn(frame))
        header = _header(time_ns, self._world_frame)
        stamped = ros.geometry_msgs__msg__TransformStamped(header, self._frame_id, transform)
        return ros.tf2_msgs__msg__TFMessage([stamped])

    def odometry(self, frame: int, time_ns: int):
        """The same as a pose, and how fast the root moves and turns, seen from itself."""
        place = ros.geometry_msgs__msg__Point(*self._places[frame].tolist())
        pose = ros.geometry_msgs__msg__Pose(place, self._turn(frame))
        twist = ros.geometry_msgs__msg__Twist(_vector(self._velocities[frame]), _vector(self._spins[frame]))
        return ros.nav_msgs__msg__Odometry(
            _header(time_ns, self._world_frame),
            self._frame_id,
            ros.geometry_msgs__msg__PoseWithCovariance(pose, UNKNOWN),
            ros.geometry_msgs__msg__TwistWithCovariance(twist, UNKNOWN),
        )

    def _turn(self, frame: int):
        return ros.geometry_msgs__msg__Quaternion(*self._turns[frame].tolist())


def write_motion(
    writer: BagWriter,
    motion: Motion,
    *,
    topic: str = "/joint_states",
    frame_id: str,
    world_frame: str = "",
) -> None:
    """Write a clip as joint states, each preceded by gravity's direction in the root frame and, with the name of a
    world frame, by where the root is in it: on /odom and /tf. Time starts at one second, as stamps of zero mean "none"
    to many tools."""
    names, nothing = list(motion.joint_names), np.zeros(0)
    root = RootMessages(motion, frame_id=frame_id, world_frame=world_frame) if world_frame else None
    for index, (positions, down) in enumerate(zip(motion.positions.astype(np.float64), motion.gravity)):
        time_ns = 1_000_000_000 + round(index * 1e9 / motion.rate_hz)
        header = _header(time_ns, frame_id)
        writer.write("/gravity", GRAVITY, ros.geometry_msgs__msg__Vector3Stamped(header, _vector(down)), time_ns)
        if root is not None:
            writer.write("/odom", ODOMETRY, root.odometry(index, time_ns), time_ns)
            writer.write("/tf", TRANSFORMS, root.transforms(index, time_ns), time_ns)
        state = ros.sensor_msgs__msg__JointState(header, names, positions, nothing, nothing)
        writer.write(topic, JOINT_STATE, state, time_ns)


def _header(time_ns: int, frame_id: str):
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(*divmod(time_ns, 1_000_000_000)), frame_id)


def _vector(values: np.ndarray):
    return ros.geometry_msgs__msg__Vector3(*values.tolist())
