"""Bags written without ROS: clouds and motion clips (extra `[replay]`). `physkin_core.motion.bag_reader` reads them."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3Stamped as Vector3Stamped
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__JointState as JointState
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__PointCloud2 as PointCloud2
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__PointField as PointField
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Header as Header

from physkin_core import Motion
from physkin_core.motion.bag_reader import GRAVITY, JOINT_STATE, ODOMETRY, TRANSFORMS, TYPES, BagError, bag_errors
from physkin_ros.messages.conversions import CLOUD_FIELDS, FLOAT32
from physkin_ros.replay.root_messages import RootMessages

__all__ = ["BagWriter", "write_motion"]

CLOUD = "sensor_msgs/msg/PointCloud2"
SINGLE_FILES = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}
METADATA_VERSION = 9  # of ROS 2 Jazzy


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
        message = PointCloud2(
            header=Header(Time(stamp.sec, stamp.nanosec), frame_id),
            height=1,
            width=len(points),
            fields=[PointField(name=name, offset=4 * i, **one) for i, name in enumerate(CLOUD_FIELDS)],
            is_bigendian=sys.byteorder == "big",
            point_step=step,
            row_step=step * len(points),
            data=np.frombuffer(np.ascontiguousarray(points, dtype=np.float32).tobytes(), dtype=np.uint8),
            is_dense=bool(np.isfinite(points).all()),
        )
        self.write(topic, CLOUD, message, time_ns)


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
    for index, (positions, gravity) in enumerate(zip(motion.positions.astype(np.float64), motion.gravity)):
        time_ns = 1_000_000_000 + round(index * 1e9 / motion.rate_hz)
        stamp = Time(*divmod(time_ns, 1_000_000_000))
        header = Header(stamp, frame_id)
        writer.write("/gravity", GRAVITY, Vector3Stamped(header, Vector3(*map(float, gravity))), time_ns)
        if root is not None:
            writer.write("/odom", ODOMETRY, root.odometry(index, stamp), time_ns)
            writer.write("/tf", TRANSFORMS, root.transforms(index, stamp), time_ns)
        writer.write(topic, JOINT_STATE, JointState(header, names, positions, nothing, nothing), time_ns)
