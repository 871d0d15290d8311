"""Two pipes between two processes, and whole messages on them: a text and the bytes of its arrays."""

from __future__ import annotations

import fcntl
import os
import struct
from time import monotonic
from typing import Any

import numpy as np

from physkin_core.native_module import native
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

    def send(self, value: object) -> None:
        """Say a value. Raises CodecError, and says nothing, where it is none that can be said."""
        text, arrays = self._codec.encode(value)
        encoded = text.encode()
        if len(encoded) > LARGEST_TEXT or sum(array.nbytes for array in arrays) > LARGEST_MESSAGE:
            raise CodecError(f"a message is too large: at most {LARGEST_MESSAGE} bytes can be sent")
        self._write(memoryview(SIZE.pack(len(encoded)) + encoded))
        for array in arrays:
            self._write(_bytes_of(array).data)

    def receive(self, deadline: float | None = None) -> Any:
        """Wait for a value. deadline: as of `monotonic`; None waits for ever."""
        size = np.empty(SIZE.size, dtype=np.uint8)
        self._read([size], deadline)
        (length,) = SIZE.unpack(size.tobytes())
        if length > LARGEST_TEXT:
            raise CodecError(f"a text of {length} bytes; at most {LARGEST_TEXT} are taken")
        encoded = np.empty(length, dtype=np.uint8)
        self._read([encoded], deadline)
        try:
            text = encoded.tobytes().decode()
        except UnicodeDecodeError as error:
            raise CodecError(f"not a message: {error}") from error
        arrays = self._codec.empty_arrays(text, LARGEST_MESSAGE)
        self._read([_bytes_of(array) for array in arrays], deadline)
        return self._codec.decode(text, arrays)

    def _write(self, content: memoryview) -> None:
        try:
            while len(content):
                content = content[os.write(self._outgoing, content) :]
        except BrokenPipeError as error:
            raise EOFError("the other end has gone") from error

    def _read(self, into: list[np.ndarray], deadline: float | None) -> None:
        """Fill arrays of bytes. All in one call, which does without the interpreter's lock: frames are due meanwhile,
        and a thread that lets it go and asks for it again may lose its core in between."""
        native.read_pipe(self._incoming, into, None if deadline is None else deadline - monotonic())

    def close(self) -> None:
        """Go. May be called again."""
        while self._open:
            os.close(self._open.pop())


def _bytes_of(array: np.ndarray) -> np.ndarray:
    """A view of a C-contiguous array: what is written there is written into it."""
    return array.reshape(-1).view(np.uint8)
