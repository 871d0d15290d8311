"""What the worker of the tests does: each request is the name of a function here, and its argument."""

from __future__ import annotations

import logging
import mmap
import os
import signal
import time
from pathlib import Path

import numpy as np

from physkin_core.worker.serving import serve


def twice(value):
    """The same value twice."""
    logging.getLogger("physkin_core.troublesome_worker").info("twice")
    return value, {"again": value}


def process(_):
    """Which process it is."""
    return os.getpid()


def threads(_):
    """How many threads there are once matrices were multiplied."""
    square = np.ones((500, 500))
    return len(os.listdir("/proc/self/task")) if (square @ square).all() else 0


def end(number):
    """Be ended by a signal."""
    os.kill(os.getpid(), number)
    time.sleep(10)


def leave(status):
    """Leave with an exit status."""
    os._exit(status)


def sleep(seconds):
    """Take time, deaf to all that Python could be told."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    time.sleep(seconds)


def zeros(mib):
    """An answer of that size."""
    return np.zeros(mib << 20, dtype=np.uint8)


def fill(mib):
    """Take memory."""
    return len(np.ones(mib << 20, dtype=np.uint8))


def refuse(text):
    """Refuse what is asked for."""
    raise ValueError(text)


def fail(_):
    """A fault of one's own."""
    return {}["nothing"]


def unspeakable(_):
    """An answer that cannot be said."""
    return lambda: None


def truncated(path):
    """Read a file that is truncated while it is read."""
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        os.truncate(path, 0)
        return content[-1]


def write(path):
    """Write a file."""
    Path(path).write_bytes(b"content")


if __name__ == "__main__":
    serve(lambda request: globals()[request[0]](request[1]))
