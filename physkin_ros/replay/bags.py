"""Bags without ROS: joint states and gravity out of rosbag2 bags, clouds and motion clips into them (extra `[replay]`).

A bag is a folder with `metadata.yaml`, or a single .mcap or .db3 file. Times are those of recording [ns].
"""

from __future__ import annotations

import itertools
import shutil
import struct
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import apsw
import numpy as np
from rosbags.rosbag2 import Reader, ReaderError, StoragePlugin, Writer, WriterError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3Stamped as Vector3Stamped
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__JointState as JointState
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__PointCloud2 as PointCloud2
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__PointField as PointField
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Header as Header

from physkin_core import Motion
from physkin_ros.messages.conversions import CLOUD_FIELDS, FLOAT32

__all__ = ["STORAGES", "BagError", "BagReader", "BagWriter", "Recorded", "UndecodableError", "write_motion"]

JOINT_STATE = "sensor_msgs/msg/JointState"
GRAVITY = "geometry_msgs/msg/Vector3Stamped"
CLOUD = "sensor_msgs/msg/PointCloud2"
STORAGES = ("mcap", "sqlite3")
SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3"}
METADATA_VERSION = 9  # of ROS 2 Jazzy
TYPES = get_typestore(Stores.ROS2_JAZZY)


class BagError(ValueError):
    """A bag cannot be read or written, or lacks what is asked for."""


class UndecodableError(ValueError):
    """The bytes of a message are not a message of its type."""


@dataclass(frozen=True)
class Recorded:
    """A message as recorded: `kind` is "joint_state" or "gravity", `data` its CDR bytes."""

    kind: str
    time_ns: int
    data: bytes


class BagReader:
    """The joint states of a bag and the gravity directions between them.

    topic: of joint states; None: `/joint_states`, or the bag's only topic of that type. gravity_topic: None: `/gravity`
    if the bag has one. Use in a `with` block.
    Raises BagError for a bag that cannot be read and for a topic that is missing, ambiguous or of another type.
    """

    def __init__(self, path: str | Path, *, topic: str | None = None, gravity_topic: str | None = None) -> None:
        self.path = Path(path)
        with _bag_errors(self.path):
            self._reader = Reader(self.path)
            self._reader.open()
        try:
            types = {connection.topic: connection.msgtype for connection in self._reader.connections}
            self.topic = _topic(self.path, types, topic, JOINT_STATE, "/joint_states", required=True)
            self.gravity_topic = _topic(self.path, types, gravity_topic, GRAVITY, "/gravity", required=False)
        except BagError:
            self._reader.close()
            raise

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *exception) -> None:
        self._reader.close()

    @property
    def joint_state_count(self) -> int:
        """Number of joint states that the bag says it holds."""
        return sum(each.msgcount for each in self._reader.connections if each.topic == self.topic)

    def __iter__(self) -> Iterator[Recorded]:
        """All messages by time of recording; of those recorded at one moment, gravity comes first, as in the node."""
        chosen = [each for each in self._reader.connections if each.topic in (self.topic, self.gravity_topic)]
        messages = self._reader.messages(chosen)
        with _bag_errors(self.path):
            for _, moment in itertools.groupby(messages, key=lambda message: message[1]):
                moment = [
                    Recorded("joint_state" if connection.topic == self.topic else "gravity", time_ns, bytes(data))
                    for connection, time_ns, data in moment
                ]
                yield from sorted(moment, key=lambda message: message.kind != "gravity")


def decode(message: Recorded):
    """The message of `rosbags` that a recorded one is. Raises UndecodableError."""
    try:
        return TYPES.deserialize_cdr(message.data, JOINT_STATE if message.kind == "joint_state" else GRAVITY)
    except (SerdeError, struct.error, ValueError, IndexError, AssertionError, OverflowError, MemoryError) as error:
        raise UndecodableError(f"{len(message.data)} bytes that are no {message.kind.replace('_', ' ')}") from error


class BagWriter:
    """Writes a bag (metadata version 9, ROS 2 Jazzy); of a `with` block that fails nothing is left.

    path: a folder to make, or a single file when it ends in .mcap or .db3. storage: "mcap" or "sqlite3", None: by the
    suffix, mcap for a folder. Raises BagError when `path` exists, cannot be written or contradicts `storage`.
    """

    def __init__(self, path: str | Path, *, storage: str | None = None) -> None:
        self.path = Path(path)
        implied = SUFFIXES.get(self.path.suffix)
        storage = storage or implied or STORAGES[0]
        if storage not in STORAGES:
            raise BagError(f"unknown storage {storage!r}; allowed: {', '.join(STORAGES)}")
        if implied not in (None, storage):
            raise BagError(f"{self.path} would be a file of {implied}, not of {storage}: choose one of them")
        if self.path.exists():
            raise BagError(f"{self.path} exists already: choose another name, or remove it")
        if not self.path.parent.is_dir():
            raise BagError(f"cannot write {self.path}: there is no folder {self.path.parent}")
        self._single = implied is not None
        self._storage = storage
        self._connections: dict[str, object] = {}

    def __enter__(self) -> BagWriter:
        try:  # beside the target, so that nobody sees half a bag and the last step is a rename
            self._folder = Path(tempfile.mkdtemp(dir=self.path.parent, prefix=f".{self.path.name}-"))
        except OSError as error:
            raise BagError(f"cannot write {self.path}: {error.strerror}") from error
        with _bag_errors(self.path):
            plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[self._storage]
            bag = self._folder / self.path.name
            self._writer = Writer(bag, version=METADATA_VERSION, storage_plugin=plugin)
            self._writer.open()
        return self

    def __exit__(self, kind, *exception) -> None:
        try:
            if kind is not None:
                self._writer.abort()
                return
            with _bag_errors(self.path):
                self._writer.close()
                made = self._folder / self.path.name
                if self._single:
                    (made,) = made.glob(f"*{self.path.suffix}")
                made.rename(self.path)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def write(self, topic: str, kind: str, message, time_ns: int) -> None:
        """Write a `rosbags` message of type `kind` (such as `sensor_msgs/msg/JointState`)."""
        self.write_bytes(topic, kind, TYPES.serialize_cdr(message, kind), time_ns)

    def write_bytes(self, topic: str, kind: str, data: bytes, time_ns: int) -> None:
        """Write a message that is CDR bytes already, right or wrong."""
        with _bag_errors(self.path):
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
    writer: BagWriter, motion: Motion, *, topic: str = "/joint_states", gravity_topic: str = "/gravity", frame_id: str
) -> None:
    """Write a clip as joint states, each preceded by gravity's direction in the root frame. Time starts at one second,
    as stamps of zero mean "none" to many tools."""
    names, nothing = list(motion.joint_names), np.zeros(0)
    for index, (positions, gravity) in enumerate(zip(motion.positions.astype(np.float64), motion.gravity)):
        time_ns = 1_000_000_000 + round(index * 1e9 / motion.rate_hz)
        header = Header(Time(*divmod(time_ns, 1_000_000_000)), frame_id)
        writer.write(gravity_topic, GRAVITY, Vector3Stamped(header, Vector3(*map(float, gravity))), time_ns)
        writer.write(topic, JOINT_STATE, JointState(header, names, positions, nothing, nothing), time_ns)


def _topic(
    path: Path, types: dict[str, str], asked: str | None, kind: str, default: str, *, required: bool
) -> str | None:
    """The topic of type `kind` to read."""
    fitting = sorted(topic for topic, its in types.items() if its == kind)
    if asked is not None:
        if types.get(asked) == kind:
            return asked
        has = f"is {types[asked]}" if asked in types else "is not in it"
        raise BagError(f"bag {path}: topic {asked} {has}; topics of {kind}: {', '.join(fitting) or 'none'}")
    if default in fitting:
        return default
    if not required:
        return None
    if len(fitting) == 1:
        return fitting[0]
    raise BagError(f"bag {path}: which topic? Topics of {kind}: {', '.join(fitting) or 'none'}")


@contextmanager
def _bag_errors(path: Path):
    """What `rosbags` and its storages raise, as BagError."""
    try:
        yield
    except (BagError, FileNotFoundError):
        raise
    except (ReaderError, WriterError, apsw.Error, OSError, struct.error, UnicodeDecodeError, KeyError) as error:
        raise BagError(f"bag {path}: {error or type(error).__name__}") from error
