"""Two pipes between two processes, and whole messages on them: a text and the bytes of its arrays."""

from __future__ import annotations

import fcntl
import os
import select
import struct
from time import monotonic
from typing import Any

import numpy as np

from physkin_core.worker.codec import Codec, CodecError

__all__ = ["Channel", "channel_ends"]

LARGEST_TEXT, LARGEST_MESSAGE = 1 << 24, 1 << 30
"""[bytes] of a message's text, and of its arrays."""
SIZE = struct.Struct("<Q")
PIPE_SIZE = 1 << 20
"""[bytes] that a pipe holds, where the system can be told: an outfit is some megabytes, and each read costs a call."""


def channel_ends() -> tuple[tuple[int, int], tuple[int, int]]:
    """What two channels that talk to each other read from and write to: (incoming, outgoing) of one and the other."""
    (one_in, other_out), (other_in, one_out) = os.pipe(), os.pipe()
    if hasattr(fcntl, "F_SETPIPE_SZ"):
        fcntl.fcntl(other_out, fcntl.F_SETPIPE_SZ, PIPE_SIZE)
    return (one_in, one_out), (other_in, other_out)


class Channel:
    """One end. Not for use by two threads at once.

    incoming, outgoing: file descriptors, which are closed with it. Raises EOFError when the other end has gone,
    TimeoutError when a deadline has passed, CodecError for what is no message; after each of these the channel is of
    no more use.
    """

    def __init__(self, incoming: int, outgoing: int, codec: Codec) -> None:
        self._incoming, self._outgoing, self._codec = incoming, outgoing, codec
        self._open = [incoming, outgoing]
        self._poll = select.poll()
        self._poll.register(incoming, select.POLLIN)

    def send(self, value: object) -> None:
        """Say a value. Raises CodecError, and says nothing, where it is none that can be said."""
        text, arrays = self._codec.encode(value)
        encoded = text.encode()
        if len(encoded) > LARGEST_TEXT or sum(array.nbytes for array in arrays) > LARGEST_MESSAGE:
            raise CodecError(f"a message is too large: at most {LARGEST_MESSAGE} bytes can be sent")
        self._write(memoryview(SIZE.pack(len(encoded)) + encoded))
        for array in arrays:
            self._write(_bytes_of(array))

    def receive(self, deadline: float | None = None) -> Any:
        """Wait for a value. deadline: as of `monotonic`; None waits for ever."""
        size = bytearray(SIZE.size)
        self._read(memoryview(size), deadline)
        (length,) = SIZE.unpack(size)
        if length > LARGEST_TEXT:
            raise CodecError(f"a text of {length} bytes; at most {LARGEST_TEXT} are taken")
        encoded = bytearray(length)
        self._read(memoryview(encoded), deadline)
        try:
            text = encoded.decode()
        except UnicodeDecodeError as error:
            raise CodecError(f"not a message: {error}") from error
        arrays = self._codec.empty_arrays(text, LARGEST_MESSAGE)
        for array in arrays:
            self._read(_bytes_of(array), deadline)
        return self._codec.decode(text, arrays)

    def _write(self, content: memoryview) -> None:
        try:
            while len(content):
                content = content[os.write(self._outgoing, content) :]
        except BrokenPipeError as error:
            raise EOFError("the other end has gone") from error

    def _read(self, into: memoryview, deadline: float | None) -> None:
        """Fill a buffer."""
        while len(into):
            left = None if deadline is None else max(1000 * (deadline - monotonic()), 0)
            if not self._poll.poll(left):
                raise TimeoutError("the other end has not answered in time")
            count = os.readv(self._incoming, [into])
            if count == 0:
                raise EOFError("the other end has gone")
            into = into[count:]

    def close(self) -> None:
        """Go. May be called again."""
        while self._open:
            os.close(self._open.pop())


def _bytes_of(array: np.ndarray) -> memoryview:
    """A view of a C-contiguous array: what is written there is written into it."""
    return array.reshape(-1).view(np.uint8).data
