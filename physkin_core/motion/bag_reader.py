"""Bags of ROS 2 read without ROS: joint states, gravity, and where the root is (extra `[replay]`).

A bag is a folder with `metadata.yaml` or one recording, or a single .mcap or .db3 file. Times are of recording [ns].
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

from physkin_core.file_reading import ContentError, reading
from physkin_core.motion.motion import MotionError

__all__ = [
    *("GRAVITY", "IMU", "JOINT_STATE", "ODOMETRY", "ORIENTATIONS", "POSE", "TRANSFORMS", "TYPES"),
    *("BagError", "BagReader", "Recorded", "UndecodableError", "bag_errors", "decode"),
]

JOINT_STATE = "sensor_msgs/msg/JointState"
GRAVITY = "geometry_msgs/msg/Vector3Stamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
IMU = "sensor_msgs/msg/Imu"
KINDS = {
    "gravity": GRAVITY,
    "pose": POSE,
    "imu": IMU,
    "odometry": ODOMETRY,
    "transforms": TRANSFORMS,
    "joint_state": JOINT_STATE,
}
"""What a message is of -> its type, in the order in which messages of one moment are taken."""
ROOT_TOPICS = {"odometry": ("/odom",), "transforms": ("/tf", "/tf_static")}
ORIENTATIONS = {"gravity": "/gravity", "pose": "/pose", "odometry": "/odom", "tf": "/tf", "imu": "/imu"}
"""What may tell where the root is, as the ROS node's parameter `orientation` names it -> its usual topic."""
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
    """The joint states of a bag and what tells where down is between them.

    topic: of joint states; None: `/joint_states`, or the bag's only topic of that type. orientation: what tells where
    the root is, one of `ORIENTATIONS`. orientation_topic: of it; None: the usual one, or the bag's only topic of that
    type. A bag may be without gravity, but not without another orientation. root: "odometry" among these for messages
    of `/odom`, too, "transforms" for those of `/tf` and `/tf_static`, where the bag has them. Use in a `with` block.
    Raises BagError for a bag that cannot be read and for a topic that is missing, ambiguous or of another type.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        topic: str | None = None,
        orientation: str = "gravity",
        orientation_topic: str | None = None,
        root: Collection[Literal["odometry", "transforms"]] = (),
    ) -> None:
        self.path = Path(path)
        with bag_errors(self.path):
            recording = self.path
            if recording.is_dir() and not (recording / "metadata.yaml").exists():
                found = [*recording.glob("*.mcap"), *recording.glob("*.db3")]
                if len(found) != 1:
                    raise ContentError(
                        f"the folder has {len(found)} .mcap or .db3 files and no metadata.yaml, which ros2 bag reindex "
                        "makes; without it one file is allowed"
                    )
                recording = found[0]
            self._reader = Reader(recording)
            self._reader.open()
        try:
            types = {connection.topic: connection.msgtype for connection in self._reader.connections}
            self.topic = _topic(self.path, types, topic, JOINT_STATE, "/joint_states", required=True)
            self.orientation_topic = _orientation_topic(self.path, types, orientation, orientation_topic)
        except BagError:
            self._reader.close()
            raise
        root = (*root, "transforms") if orientation == "tf" else root
        self._kinds = {name: kind for kind in root for name in ROOT_TOPICS[kind] if types.get(name) == KINDS[kind]}
        self._kinds[self.topic] = "joint_state"
        if self.orientation_topic is not None:
            self._kinds[self.orientation_topic] = orientation

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
        """All messages by time of recording; of those recorded at one moment, joint states come last."""
        chosen = [each for each in self._reader.connections if each.topic in self._kinds]
        messages, order = self._reader.messages(chosen), list(KINDS)
        with bag_errors(self.path):
            for _, moment in itertools.groupby(messages, key=lambda message: message[1]):
                moment = [
                    Recorded(
                        self._kinds[connection.topic],
                        time_ns,
                        bytes(data),
                        connection.topic,
                    )
                    for connection, time_ns, data in moment
                ]
                yield from sorted(moment, key=lambda message: order.index(message.kind))


def decode(message: Recorded):
    """The message of `rosbags` that a recorded one is. Raises UndecodableError."""
    try:
        return TYPES.deserialize_cdr(message.data, KINDS[message.kind])
    except (SerdeError, struct.error, ValueError, IndexError, AssertionError, OverflowError, MemoryError) as error:
        raise UndecodableError(f"{len(message.data)} bytes that are no {message.kind.replace('_', ' ')}") from error


def _orientation_topic(path: Path, types: dict[str, str], orientation: str, asked: str | None) -> str | None:
    """The topic that tells where the root is; None for TF, which has two, and for gravity that is not there."""
    if orientation not in ORIENTATIONS:
        raise BagError(f"unknown orientation {orientation!r}; allowed: {', '.join(ORIENTATIONS)}")
    if orientation != "tf":
        known, required = KINDS[orientation], orientation != "gravity"
        return _topic(path, types, asked, known, ORIENTATIONS[orientation], required=required)
    if asked is not None:
        raise BagError(f"topic {asked}: TF is always taken from {' and '.join(ROOT_TOPICS['transforms'])}")
    if not any(types.get(topic) == TRANSFORMS for topic in ROOT_TOPICS["transforms"]):
        raise BagError(f"bag {path} has no transforms on {' or '.join(ROOT_TOPICS['transforms'])}{_listed(types)}")
    return None


def _listed(types: dict[str, str]) -> str:
    return f"; its topics: {', '.join(f'{topic} ({its})' for topic, its in sorted(types.items())) or 'none'}"


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
        raise BagError(f"bag {path} has no topic of {kind}{_listed(types)}")
    raise BagError(f"bag {path}: which topic? Topics of {kind}: {', '.join(fitting)}")


@contextmanager
def bag_errors(path: Path):
    """Whatever goes wrong in `rosbags` and its storages, as BagError."""
    with reading(f"bag {path}", BagError):
        try:
            yield
        except (ReaderError, WriterError, apsw.Error) as error:
            text = str(error) or type(error).__name__
            remedy = next((f" {what_to_do}" for said, what_to_do in REMEDIES.items() if said in text), "")
            raise ContentError(f"{text}{remedy}") from error
