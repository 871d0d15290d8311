"""Between ROS messages and the core's arrays: joint states in; clouds, garment description and garment nodes out.

Dimensions: `d` degrees of freedom, `n` garment vertices, `m` garment nodes. Radians, metres, root frame.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from physkin_core import Draper
from physkin_ros.joint_map import MappedJoint

__all__ = [
    "CLOUD_FIELDS",
    "GarmentCloud",
    "JointStateError",
    "JointStateReader",
    "garment_description",
    "gravity_direction",
    "read_cloud",
]

CLOUD_FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z")
FLOAT32 = 7  # sensor_msgs/PointField.FLOAT32
CACHED_NAME_SETS = 64


class JointStateError(ValueError):
    """A joint state cannot be used; the text says what is wrong with it."""


@dataclass(frozen=True)
class _Selection:
    """Which positions of a message go where: rig[target] = scale * message[source] + offset, all of length k."""

    source: np.ndarray
    target: np.ndarray
    scale: np.ndarray
    offset: np.ndarray


class JointStateReader:
    """Turns joint states into the joint positions of a rig, whatever the order and number of joints they name.

    joint_names, rest: (d,) names and initial positions [rad]. joint_map: incoming names that are not the rig's own.
    on_unknown: called with the names that mean nothing here, once for each new set of names.
    positions: (d,) float32 [rad], the last good state; joints that a message does not name stay there.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        rest: np.ndarray,
        *,
        joint_map: Mapping[str, MappedJoint] | None = None,
        on_unknown: Callable[[list[str]], None] = lambda names: None,
    ) -> None:
        self.positions = np.array(rest, dtype=np.float32)
        self._index = {name: index for index, name in enumerate(joint_names)}
        self._map = dict(joint_map or {})
        self._on_unknown = on_unknown
        self._selections: dict[tuple[str, ...], _Selection] = {}

    def read(self, names: Sequence[str], values: Sequence[float]) -> np.ndarray:
        """Joint positions (d,) float32 [rad] after a joint state; assign to `positions` to keep them.

        names, values: name and position [rad] of a `sensor_msgs/JointState`, of equal length.
        Raises JointStateError when it names no joint, none that is known or one twice, has another number of positions
        than names, or a position for a known joint that is not finite in single precision.
        """
        names = tuple(names)
        values = np.asarray(values, dtype=np.float64)
        if not names:
            raise JointStateError("the joint state names no joints")
        if len(values) != len(names):
            raise JointStateError(f"the joint state has {len(names)} names but {len(values)} positions")
        selection = self._selections.get(names) or self._select(names)
        with np.errstate(over="ignore", invalid="ignore"):
            read = (selection.scale * values[selection.source] + selection.offset).astype(np.float32)
        finite = np.isfinite(read)
        if not finite.all():
            bad = selection.source[np.flatnonzero(~finite)[0]]
            raise JointStateError(f"the position of joint {names[bad]!r} is {values[bad]}; it must be finite [rad]")
        positions = self.positions.copy()
        positions[selection.target] = read
        return positions

    def _select(self, names: tuple[str, ...]) -> _Selection:
        """Look the names up, once for each set of names."""
        mapped = [self._map.get(name, MappedJoint(name)) for name in names]
        source = [index for index, entry in enumerate(mapped) if entry.joint in self._index]
        if not source:
            raise JointStateError(f"no joint is known among {_some(names)}; the rig has {_some(list(self._index))}")
        driven: dict[str, str] = {}
        for index in source:
            joint = mapped[index].joint
            if joint in driven:
                raise JointStateError(f"joints {driven[joint]!r} and {names[index]!r} are the same joint, {joint!r}")
            driven[joint] = names[index]
        if len(source) < len(names):
            self._on_unknown([name for name, entry in zip(names, mapped) if entry.joint not in self._index])
        selection = _Selection(
            source=np.array(source),
            target=np.array([self._index[mapped[index].joint] for index in source]),
            scale=np.array([mapped[index].scale for index in source]),
            offset=np.array([mapped[index].offset for index in source]),
        )
        if len(self._selections) >= CACHED_NAME_SETS:
            self._selections.clear()
        self._selections[names] = selection
        return selection


class GarmentCloud:
    """One `sensor_msgs/PointCloud2`, filled in place and published again and again.

    message: the message; set its stamp. points: (n, 6) float32 view of its data, x, y, z [m] and unit normal.
    """

    def __init__(self, point_count: int, frame_id: str) -> None:
        from sensor_msgs.msg import PointCloud2, PointField

        step = 4 * len(CLOUD_FIELDS)
        fields = [PointField(name=name, offset=4 * i, datatype=FLOAT32, count=1) for i, name in enumerate(CLOUD_FIELDS)]
        self.message = PointCloud2(
            height=1,
            width=point_count,
            fields=fields,
            is_bigendian=sys.byteorder == "big",
            point_step=step,
            row_step=step * point_count,
            data=array("B", bytes(step * point_count)),
            is_dense=True,
        )
        self.message.header.frame_id = frame_id
        self.points = np.frombuffer(self.message.data, dtype=np.float32).reshape(point_count, len(CLOUD_FIELDS))


def read_cloud(message) -> np.ndarray:
    """The points of a garment cloud: (n, 6) float32 view of the message's data, x, y, z [m] and unit normal.

    Raises ValueError when the `sensor_msgs/PointCloud2` is not laid out as a garment cloud, or its data are too short.
    """
    layout = [(field.name, field.offset, field.datatype, field.count) for field in message.fields]
    expected = [(name, 4 * index, FLOAT32, 1) for index, name in enumerate(CLOUD_FIELDS)]
    if layout != expected or message.height != 1 or message.is_bigendian != (sys.byteorder == "big"):
        raise ValueError(f"no garment cloud: fields {layout}, height {message.height}; expected {expected}, height 1")
    if message.point_step < 4 * len(CLOUD_FIELDS) or len(message.data) < message.point_step * message.width:
        raise ValueError(f"{len(message.data)} bytes of data for {message.width} points of {message.point_step} bytes")
    shape, strides = (message.width, len(CLOUD_FIELDS)), (message.point_step, 4)
    return np.ndarray(shape, dtype=np.float32, buffer=message.data, strides=strides)


def garment_description(draper: Draper, frame_id: str):
    """The `physkin_msgs/GarmentDescription` of what a draper publishes; the stamp is left to the caller."""
    from physkin_msgs.msg import GarmentDescription

    model = draper.model
    message = GarmentDescription(
        model_name=model.name,
        vertex_count=draper.vertex_count,
        faces=array("I", draper.faces.astype(np.uint32).tobytes()),
        rest_vertices=array("f", draper.bound.vertices.astype(np.float32).tobytes()),
        node_count=len(model.node_rest),
        joint_names=list(draper.joint_names),
        joint_rest=array("f", model.rig.rest.astype(np.float32).tobytes()),
    )
    message.header.frame_id = frame_id
    return message


def gravity_direction(value) -> np.ndarray:
    """A direction of gravity (3,) from three numbers of any length but zero. Raises ValueError."""
    if isinstance(value, (list, tuple, array)):
        value = list(value)
        numbers = all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in value)
        with np.errstate(over="ignore"):
            if numbers and len(value) == 3 and np.isfinite(value).all() and 1e-9 < np.linalg.norm(value) < np.inf:
                return np.array(value, dtype=np.float64)
    raise ValueError(f"gravity is {value!r}; it must be three finite numbers, not all zero, such as [0.0, 0.0, -1.0]")


def _some(names: Sequence[str], count: int = 4) -> str:
    return ", ".join(names[:count]) + (f" and {len(names) - count} more" if len(names) > count else "")
