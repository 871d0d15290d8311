"""Messages come whole, read in few calls, or by a deadline not at all."""

from __future__ import annotations

import os
import signal
import time
from threading import Thread

import numpy as np
import pytest

from physkin_core.worker import channel as channel_module
from physkin_core.worker.channel import Channel, channel_ends
from physkin_core.worker.codec import Codec


@pytest.fixture
def ends():
    """Two channels that talk to each other."""
    one, other = (Channel(*ends, Codec([])) for ends in channel_ends())
    yield one, other
    one.close()
    other.close()


def test_other_threads_go_on_while_arrays_come(ends, monkeypatch):
    """Megabytes in ninety arrays, some of them empty: read in one call without the interpreter's lock. Each call more
    hands it over twice, while a frame may be due."""
    one, other = ends
    calls, read_pipe = [], channel_module.native.read_pipe

    def counted(pipe, into, seconds):
        calls.append(len(into))
        read_pipe(pipe, into, seconds)

    monkeypatch.setattr(channel_module.native, "read_pipe", counted)
    arrays = [np.arange(k % 7 * 10_000, dtype=np.int32) for k in range(90)]
    sending = Thread(target=other.send, args=(arrays,))
    sending.start()
    received = one.receive(time.monotonic() + 60)
    sending.join()
    for sent, came in zip(arrays, received, strict=True):
        np.testing.assert_array_equal(sent, came)
    assert calls == [1, 1, 90]


def test_a_deadline_passes_in_the_middle_of_a_message(ends):
    one, other = ends
    other._write(memoryview(b"\5" + bytes(7) + b"abc"))
    began = time.monotonic()
    with pytest.raises(TimeoutError, match="has not answered in time"):
        one.receive(began + 0.3)
    assert 0.2 < time.monotonic() - began < 5


def test_the_other_end_goes_in_the_middle_of_a_message(ends):
    one, other = ends
    other._write(memoryview(b"\5" + bytes(7) + b"abc"))
    other.close()
    with pytest.raises(EOFError, match="has gone"):
        one.receive()
    with pytest.raises(EOFError, match="has gone"):
        one.send(1)


def test_what_is_no_pipe():
    with pytest.raises(OSError, match="Bad file descriptor"):
        channel_module.native.read_pipe(1 << 20, [np.empty(1, dtype=np.uint8)], 5.0)


def test_ctrl_c_ends_waiting(ends):
    """In the first thread, which is the one that Python tells of signals."""
    one, _ = ends
    Thread(target=lambda: (time.sleep(0.3), os.kill(os.getpid(), signal.SIGINT))).start()
    with pytest.raises(KeyboardInterrupt):
        one.receive(time.monotonic() + 20)
