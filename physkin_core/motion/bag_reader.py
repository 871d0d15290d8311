"""Bags of ROS 2 read without ROS: joint states, gravity, and where the root is (extra `[replay]`).

A bag is a folder with `metadata.yaml`, or a single .mcap or .db3 file. Times are those of recording [ns].
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import apsw
from rosbags.rosbag2 import Reader, ReaderError, WriterError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from physkin_core.motion.motion import MotionError

__all__ = [
    *("GRAVITY", "JOINT_STATE", "ODOMETRY", "TRANSFORMS", "TYPES"),
    *("BagError", "BagReader", "Recorded", "UndecodableError", "bag_errors", "decode"),
]

JOINT_STATE = "sensor_msgs/msg/JointState"
GRAVITY = "geometry_msgs/msg/Vector3Stamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
KINDS = {"gravity": GRAVITY, "odometry": ODOMETRY, "transforms": TRANSFORMS, "joint_state": JOINT_STATE}
"""What a message is of -> its type, in the order in which messages of one moment are taken."""
ROOT_TOPICS = {"odometry": ("/odom",), "transforms": ("/tf", "/tf_static")}
REMEDIES = {
    "File end magic is invalid": "The recording was broken off; mcap recover BROKEN -o WHOLE mends it",
    "Unrecognized storage format '.bag'": "Bags of ROS 1 are converted by rosbags-convert --src OLD --dst NEW",
    "Unrecognized storage format": "Allowed: .mcap, .db3, or a folder with metadata.yaml",
}
"""What `rosbags` says of a file that is no readable bag -> what to do; the first that fits."""
TYPES = get_typestore(Stores.ROS2_JAZZY)


class BagError(MotionError):
    """A bag cannot be read or written, or lacks what is asked for."""


class UndecodableError(ValueError):
    """The bytes of a message are not a message of its type."""


@dataclass(frozen=True)
class Recorded:
    """A message as recorded: `kind` is one of `KINDS`, `data` its CDR bytes."""

    kind: str
    time_ns: int
    data: bytes
    topic: str


class BagReader:
    """The joint states of a bag and the gravity directions between them.

    topic: of joint states; None: `/joint_states`, or the bag's only topic of that type. gravity_topic: None: `/gravity`
    if the bag has one. root: "odometry" among these for messages of `/odom`, too, "transforms" for those of `/tf` and
    `/tf_static`, where the bag has them. Use in a `with` block.
    Raises BagError for a bag that cannot be read and for a topic that is missing, ambiguous or of another type.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        topic: str | None = None,
        gravity_topic: str | None = None,
        root: Collection[Literal["odometry", "transforms"]] = (),
    ) -> None:
        self.path = Path(path)
        with bag_errors(self.path):
            self._reader = Reader(self.path)
            self._reader.open()
        try:
            types = {connection.topic: connection.msgtype for connection in self._reader.connections}
            self.topic = _topic(self.path, types, topic, JOINT_STATE, "/joint_states", required=True)
            self.gravity_topic = _topic(self.path, types, gravity_topic, GRAVITY, "/gravity", required=False)
        except BagError:
            self._reader.close()
            raise
        self._kinds = {name: kind for kind in root for name in ROOT_TOPICS[kind] if types.get(name) == KINDS[kind]}
        self._kinds[self.topic] = "joint_state"
        if self.gravity_topic is not None:
            self._kinds[self.gravity_topic] = "gravity"

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *exception) -> None:
        self._reader.close()

    @property
    def topics(self) -> dict[str, str]:
        """Topic -> what its messages are of, of those that are read."""
        return dict(self._kinds)

    @property
    def joint_state_count(self) -> int:
        """Number of joint states that the bag says it holds."""
        return sum(each.msgcount for each in self._reader.connections if each.topic == self.topic)

    def __iter__(self) -> Iterator[Recorded]:
        """All messages by time of recording; of those recorded at one moment, gravity comes first, as in the node."""
        chosen = [each for each in self._reader.connections if each.topic in self._kinds]
        messages, order = self._reader.messages(chosen), list(KINDS)
        with bag_errors(self.path):
            for _, moment in itertools.groupby(messages, key=lambda message: message[1]):
                moment = [
                    Recorded(self._kinds[connection.topic], time_ns, bytes(data), connection.topic)
                    for connection, time_ns, data in moment
                ]
                yield from sorted(moment, key=lambda message: order.index(message.kind))


def decode(message: Recorded):
    """The message of `rosbags` that a recorded one is. Raises UndecodableError."""
    try:
        return TYPES.deserialize_cdr(message.data, KINDS[message.kind])
    except (SerdeError, struct.error, ValueError, IndexError, AssertionError, OverflowError, MemoryError) as error:
        raise UndecodableError(f"{len(message.data)} bytes that are no {message.kind.replace('_', ' ')}") from error


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
    if not fitting:
        has = ", ".join(f"{topic} ({its})" for topic, its in sorted(types.items())) or "none"
        raise BagError(f"bag {path} has no topic of {kind}; its topics: {has}")
    raise BagError(f"bag {path}: which topic? Topics of {kind}: {', '.join(fitting)}")


@contextmanager
def bag_errors(path: Path):
    """What `rosbags` and its storages raise, as BagError."""
    try:
        yield
    except (BagError, FileNotFoundError):
        raise
    except (ReaderError, WriterError, apsw.Error, OSError, struct.error, UnicodeDecodeError, KeyError) as error:
        told = str(error) or type(error).__name__
        remedy = next((f" {what_to_do}" for said, what_to_do in REMEDIES.items() if said in told), "")
        raise BagError(f"bag {path}: {told}{remedy}") from error
