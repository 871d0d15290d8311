"""Messages that are kept as the bytes they travel as, and filled in place: a publisher takes bytes as they are.

A marker's points would be Python objects otherwise, tens of thousands a frame; a cloud costs the same either way.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rclpy.publisher import Publisher

__all__ = ["SerialisedMessage"]

PERIOD = bytes(range(1, 25))
"""Three numbers of 8 bytes or six of 4, none of which is the same, or not finite."""
STAMP, STAMP_OFFSET = struct.Struct("=iI"), 4  # after the encapsulation, in any message that begins with a header


class SerialisedMessage:
    """A stamped message of constant size.

    message_of: makes the message of the bytes of its payload; asked once, of bytes in which `PERIOD` recurs, by which
    their place is found. payload: view of that place, of this shape and dtype, zeros at first.
    Raises RuntimeError when the middleware lays the message out otherwise than expected.
    """

    def __init__(self, message_of: Callable[[bytes], object], shape: tuple[int, ...], dtype: type) -> None:
        from rclpy.serialization import serialize_message

        count = int(np.prod(shape))
        size = count * np.dtype(dtype).itemsize
        pattern = (PERIOD * (size // len(PERIOD) + 1))[:size]
        data = serialize_message(message_of(pattern))
        at = data.find(pattern)
        if at < 0 or data[:2] != (b"\0\1" if sys.byteorder == "little" else b"\0\0"):
            raise RuntimeError("cannot fill serialised messages in place with this middleware")
        self._buffer = bytearray(data)
        self._buffer[at : at + size] = bytes(size)
        self.payload = np.frombuffer(self._buffer, dtype=dtype, count=count, offset=at).reshape(shape)

    def publish(self, publisher: Publisher, sec: int, nanosec: int) -> None:
        """Publish the message as it is now, with this stamp, without the copy that `Publisher.publish` asks for.

        Raises rclpy's RCLError when the publisher is destroyed; no other thread may destroy it meanwhile.
        """
        STAMP.pack_into(self._buffer, STAMP_OFFSET, sec, nanosec)
        publisher.handle.publish_raw(self._buffer)
