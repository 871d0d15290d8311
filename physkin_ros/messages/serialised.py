"""Messages as the bytes they travel as. What is published is kept so, and filled in place: a publisher takes bytes as
they are. What comes in is read so, where it may be of another version of `physkin_msgs`.

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

__all__ = ["SerialisedMessage", "read_serialised"]

PERIOD = bytes(range(1, 25))
"""Three numbers of 8 bytes or six of 4, none of which is the same, or not finite."""
STAMP, STAMP_OFFSET = struct.Struct("=iI"), 4  # after the encapsulation, in any message that begins with a header


class SerialisedMessage:
    """A stamped message of constant size.

    message_of: makes the message of the bytes of its payloads, in the order of their fields; asked once, of bytes in
    which `PERIOD` recurs, by which their places are found. payloads: views of these, of the shapes and dtype, zeros at
    first.
    Raises RuntimeError when the middleware lays the message out otherwise than expected.
    """

    def __init__(self, message_of: Callable[..., object], *shapes: tuple[int, ...], dtype: np.typing.DTypeLike) -> None:
        from rclpy.serialization import serialize_message

        sizes = [int(np.prod(shape)) * np.dtype(dtype).itemsize for shape in shapes]
        patterns = [(PERIOD * (size // len(PERIOD) + 1))[:size] for size in sizes]
        data = serialize_message(message_of(*patterns))
        self._buffer = bytearray(data)
        self.payloads: tuple[np.ndarray, ...] = ()
        end = 0
        for shape, size, pattern in zip(shapes, sizes, patterns):
            at = data.find(pattern, end)
            if at < 0 or data[:2] != (b"\0\1" if sys.byteorder == "little" else b"\0\0"):
                raise RuntimeError("cannot fill serialised messages in place with this middleware")
            end = at + size
            self._buffer[at:end] = bytes(size)
            self.payloads += (np.ndarray(shape, dtype=dtype, buffer=self._buffer, offset=at),)

    def publish(self, publisher: Publisher, sec: int, nanosec: int) -> None:
        """Publish the message as it is now, with this stamp, without the copy that `Publisher.publish` asks for.

        Raises rclpy's RCLError when the publisher is destroyed; no other thread may destroy it meanwhile.
        """
        STAMP.pack_into(self._buffer, STAMP_OFFSET, sec, nanosec)
        publisher.handle.publish_raw(self._buffer)


def read_serialised(data: bytes, kind: type):
    """The message of `kind` that these bytes of a `raw` subscription are; others drop what they cannot read in silence.
    Raises ValueError for bytes of another version of the message, as an older bag may have them."""
    from rclpy.serialization import deserialize_message

    try:
        return deserialize_message(data, kind)
    except RuntimeError:
        package = kind.__module__.partition(".")[0]
        raise ValueError(
            f"{len(data)} bytes are no {kind.__name__} as {package} has it here; node or bag and reader must have the "
            f"same version of {package}"
        ) from None
