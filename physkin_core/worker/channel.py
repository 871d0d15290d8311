"""A socket between two processes, and whole messages on it: a text and the bytes of its arrays."""

from __future__ import annotations

import socket
import struct
from time import monotonic
from typing import Any

import numpy as np

from physkin_core.worker.codec import Codec, CodecError

__all__ = ["LARGEST_MESSAGE", "Channel"]

LARGEST_TEXT, LARGEST_MESSAGE = 1 << 24, 1 << 30
"""[bytes] of a message's text, and of its arrays."""
SIZE = struct.Struct("<Q")


class Channel:
    """One end. Not for use by two threads at once.

    Raises EOFError when the other end has gone, TimeoutError when a deadline has passed, CodecError for what is no
    message; after each of these the channel is of no more use.
    """

    def __init__(self, end: socket.socket, codec: Codec) -> None:
        self._end, self._codec = end, codec

    def send(self, value: object) -> None:
        """Say a value. Raises CodecError, and says nothing, where it is none that can be said."""
        text, arrays = self._codec.encode(value)
        encoded = text.encode()
        if len(encoded) > LARGEST_TEXT or sum(array.nbytes for array in arrays) > LARGEST_MESSAGE:
            raise CodecError(f"a message is too large: at most {LARGEST_MESSAGE} bytes can be sent")
        self._end.settimeout(None)
        try:
            self._end.sendall(SIZE.pack(len(encoded)) + encoded)
            for array in arrays:
                self._end.sendall(_bytes_of(array))
        except (BrokenPipeError, ConnectionResetError) as error:
            raise EOFError("the other end has gone") from error

    def receive(self, deadline: float | None = None) -> Any:
        """Wait for a value. deadline: as of `monotonic`; None waits for ever."""
        (length,) = SIZE.unpack(self._read(bytearray(SIZE.size), deadline))
        if length > LARGEST_TEXT:
            raise CodecError(f"a text of {length} bytes; at most {LARGEST_TEXT} are taken")
        try:
            text = self._read(bytearray(length), deadline).decode()
        except UnicodeDecodeError as error:
            raise CodecError(f"not a message: {error}") from error
        arrays = self._codec.empty_arrays(text, LARGEST_MESSAGE)
        for array in arrays:
            self._read(_bytes_of(array), deadline)
        return self._codec.decode(text, arrays)

    def _read(self, into: Any, deadline: float | None) -> Any:
        """Fill a buffer, whose elements are bytes."""
        left = memoryview(into)
        while len(left):
            if deadline is not None:
                self._end.settimeout(max(deadline - monotonic(), 1e-3))
            try:
                count = self._end.recv_into(left)
            except ConnectionResetError:
                count = 0
            if count == 0:
                raise EOFError("the other end has gone")
            left = left[count:]
        return into

    def close(self) -> None:
        """Go."""
        self._end.close()


def _bytes_of(array: np.ndarray) -> memoryview:
    """A view of a C-contiguous array: what is written there is written into it."""
    return array.reshape(-1).view(np.uint8).data
