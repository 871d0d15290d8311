"""Messages that are kept as the bytes they travel as, and filled in place: a publisher takes bytes as they are.

A marker's points would be Python objects otherwise, tens of thousands a frame; a cloud costs the same either way.
"""

from __future__ import annotations

import struct
import sys
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rclpy.publisher import Publisher

__all__ = ["MARKER", "SerialisedMessage"]

MARKER = 1.2345678e-30
"""Fills a payload of floating point until its place among the bytes is known."""

STAMP_OFFSET = 4  # after the encapsulation, in any message that begins with a header


class SerialisedMessage:
    """A stamped message of constant size.

    message: with its payload, an array of numbers, filled with `marker`; nothing else in it may be `marker`.
    payload: view of the payload, of the shape and dtype of `marker`, zeros at first.
    Raises RuntimeError when the middleware lays the message out otherwise than expected.
    """

    def __init__(self, message, marker: np.ndarray) -> None:
        from rclpy.serialization import serialize_message

        data = serialize_message(message)
        pattern = marker.tobytes()
        at = data.find(pattern)
        if at < 0 or data[:2] != (b"\0\1" if sys.byteorder == "little" else b"\0\0"):
            raise RuntimeError(f"cannot fill a serialised {type(message).__name__} in place with this middleware")
        self._buffer = bytearray(data)
        self._stamp = struct.Struct("=iI")
        self.payload = np.frombuffer(self._buffer, dtype=marker.dtype, count=marker.size, offset=at)
        self.payload.fill(0)
        self.payload = self.payload.reshape(marker.shape)

    def stamped(self, sec: int, nanosec: int) -> bytes:
        """The message as it is now, with this stamp; a copy."""
        self._stamp.pack_into(self._buffer, STAMP_OFFSET, sec, nanosec)
        return bytes(self._buffer)

    def publish(self, publisher: Publisher, sec: int, nanosec: int) -> None:
        """Publish the message as it is now, with this stamp, without the copy that `Publisher.publish` asks for.

        Raises rclpy's RCLError when the publisher is destroyed; no other thread may destroy it meanwhile.
        """
        self._stamp.pack_into(self._buffer, STAMP_OFFSET, sec, nanosec)
        publisher.handle.publish_raw(self._buffer)
