"""`sensor_msgs/JointState` straight from its serialised bytes (CDR).

rclpy makes a Python string of every joint name in every message. Here the bytes before the positions (frame and names)
are compared with those of earlier messages, and only new ones are looked into. The positions are read by native code:
a dozen array operations, each of whose code the caches have lost since the last message, take ten times as long.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass

import numpy as np
import physkin_core._native as _native

from physkin_ros.joints.joint_states import JointStateError, JointStateReader, Selection

__all__ = ["MOST_NAMES", "JointStateWire"]

MOST_NAMES = 4096
"""A message that names more joints is refused unread."""
LONGEST_BEGINNING = 1 << 18
"""[bytes] So is one whose frame and names are longer."""
RECENT = 8  # layouts of messages that are kept: publishers that take turns on one topic
ORDER = {0: ">", 1: "<"}  # second byte of the encapsulation: plain CDR, big or little endian


@dataclass(frozen=True)
class _Layout:
    """What the bytes up to the positions mean.

    beginning: of them what is compared: not the stamp, nor the padding after names, which middleware leaves as it is.
    reading: of ordinary positions; None where ball joints are to be solved, too.
    """

    beginning: _native.MessageBeginning
    stamp: struct.Struct
    dtype: np.dtype
    count: int
    offset: int
    selection: Selection | JointStateError
    reading: _native.JointReading | None


class JointStateWire:
    """Reads serialised joint states for a `JointStateReader` into one array.

    out: (d,) float32 [rad], contiguous; the joint positions after each message.
    stamp: (sec, nanosec) of the last message.
    """

    def __init__(self, reader: JointStateReader, out: np.ndarray) -> None:
        self.stamp = (0, 0)
        self._reader, self._out = reader, out
        self._recent: list[_Layout] = []
        self._from, self._to = memoryview(out), memoryview(reader.positions)

    def keep(self) -> None:
        """Make the joint positions in `out` the reader's last good ones."""
        self._to[:] = self._from

    def read(self, data: bytes) -> None:
        """Take over a message.

        Raises JointStateError as the reader does, and for bytes that are no joint state; `out` may have changed.
        """
        for layout in self._recent:
            if layout.beginning.matches(data):
                break
        else:
            layout = self._look_into(data)
        if isinstance(layout.selection, JointStateError):
            raise layout.selection.with_traceback(None)
        self.stamp = layout.stamp.unpack_from(data, 4)
        if len(data) < layout.offset + 8 * layout.count:
            raise JointStateError(f"the joint state is cut off: {len(data)} bytes")
        if layout.reading is None or not layout.reading.read(data):
            values = np.frombuffer(data, layout.dtype, layout.count, layout.offset)
            self._reader.read_selected(layout.selection, values, self._out)

    def _look_into(self, data: bytes) -> _Layout:
        layout = _read_layout(data, self._reader, self._out)
        self._recent = [layout, *self._recent[: RECENT - 1]]
        return layout


def _read_layout(data: bytes, reader: JointStateReader, out: np.ndarray) -> _Layout:
    order = ORDER.get(data[1]) if len(data) >= 16 and data[0] == 0 else None
    if order is None:
        raise JointStateError(
            f"the message is not a joint state: {len(data)} bytes that start with {data[:4].hex(' ')}"
        )
    length = struct.Struct(f"{order}I")
    at = 12
    padding = [slice(4, 12)]  # and the stamp

    def after_padding(at: int) -> int:
        if LONGEST_BEGINNING < at <= len(data):
            raise JointStateError(
                f"frame and names of the joint state have over {LONGEST_BEGINNING} bytes; shorten or leave out names"
            )
        padding.append(slice(at, at + -at % 4))
        return at + -at % 4

    selection: Selection | JointStateError
    reading = None
    try:
        at = after_padding(at + 4 + length.unpack_from(data, at)[0])  # frame_id
        (count,) = length.unpack_from(data, at)
        if count > MOST_NAMES:
            raise JointStateError(f"the joint state names {count} joints; at most {MOST_NAMES} are read")
        at += 4
        names = []
        for _ in range(count):
            at = after_padding(at)
            (size,) = length.unpack_from(data, at)
            names.append(data[at + 4 : at + 4 + max(0, size - 1)].decode(errors="replace"))
            at += 4 + size
        at = after_padding(at)
        (values,) = length.unpack_from(data, at)
        at += 4
    except struct.error:
        raise JointStateError(f"the joint state is cut off: {len(data)} bytes") from None
    end = at
    offset = end + -(end - 4) % 8  # CDR aligns from after the four bytes of encapsulation
    try:
        reader.check_count(names, values)
        selection = reader.select(tuple(names))
        if selection.balls is None:
            swapped = (order == "<") != (sys.byteorder == "little")
            reading = selection.bind_reading(offset, swapped, reader.positions, out)
    except JointStateError as error:
        selection = error
    stamp, dtype = struct.Struct(f"{order}iI"), np.dtype(f"{order}f8")
    mask = bytearray(b"\xff" * end)
    for unsaid in padding:
        mask[unsaid] = bytes(unsaid.stop - unsaid.start)
    beginning = _native.MessageBeginning(data[:end], bytes(mask))
    return _Layout(beginning, stamp, dtype, values, offset, selection, reading)
