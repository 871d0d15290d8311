"""The worker's side: limits that this process is put under, and requests that it answers until nobody asks any more.

What is promised: such a process takes no more memory and time than it may, writes no file, leaves no core dump, and
ends with whoever started it. It opens no socket of its own, but nothing would keep code that has taken it over from
opening one: it contains accidents and bombs, not an attacker who runs code.
"""

from __future__ import annotations

import argparse
import logging
import os
import resource
import select
import signal
import warnings
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

from physkin_core.worker.channel import Channel
from physkin_core.worker.codec import Codec, CodecError

__all__ = ["serve"]

MIB = 1 << 20
LONGEST_LINE = 1000
"""Letters of what is logged."""
POLITENESS = 10
"""Others, whose frames are due, get a core first."""
OVERTIME = 5
"""[s] after its time the process ends by itself, where nobody ended it."""


def serve(answer: Callable[[Any], object], codec: Codec) -> None:
    """Answer requests until the other end goes. Arguments of the command line: `Worker` gives them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("incoming", type=int, help="pipe of requests")
    parser.add_argument("outgoing", type=int, help="pipe of answers")
    parser.add_argument("seconds", type=float)
    parser.add_argument("memory", type=int, help="[MiB]")
    given = parser.parse_args()
    channel = Channel(given.incoming, given.outgoing, codec)
    Thread(target=_end_with, args=(given.outgoing,), daemon=True).start()
    _limit(given.memory)
    warnings.simplefilter("ignore")  # what is worth saying is in what is loaded
    logger = logging.getLogger("physkin_core")
    logger.setLevel(logging.INFO)
    logger.addHandler(_Forwarding(channel))
    logger.propagate = False
    channel.send({"ready": True})
    while True:
        try:
            request = channel.receive()
        except EOFError:
            return
        signal.setitimer(signal.ITIMER_REAL, given.seconds + OVERTIME)
        try:
            said: dict[str, object] = {"answer": answer(request)}
        except MemoryError:
            said = {"memory": True}
        except (ValueError, OSError) as error:
            said = {"refused": str(error)}
        except Exception as error:  # a fault of ours, or of a library: this request's alone
            said = {"failed": f"{type(error).__name__}: {error}"[:LONGEST_LINE]}
        try:
            channel.send(said)
        except CodecError as error:
            channel.send({"failed": f"{type(error).__name__}: {error}"})
        except EOFError:
            return
        signal.setitimer(signal.ITIMER_REAL, 0)


def _limit(memory: int) -> None:
    """Put this process under its limits. memory: [MiB] more than it has now."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends it, whatever it is doing
    has = 0
    if (statm := Path("/proc/self/statm")).is_file():
        has = int(statm.read_text().split()[0]) * resource.getpagesize()
    for limit, most in (
        (resource.RLIMIT_AS, has + memory * MIB),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        _, highest = resource.getrlimit(limit)
        most = most if highest == resource.RLIM_INFINITY else min(most, highest)
        resource.setrlimit(limit, (most, most))
    os.nice(POLITENESS)


def _end_with(outgoing: int) -> None:
    """End this process when nobody reads from a pipe any more, however that came, and whatever is being done here."""
    poll = select.poll()
    poll.register(outgoing, select.POLLERR)
    poll.poll()
    os._exit(0)


class _Forwarding(logging.Handler):
    """Says what is logged to the other end."""

    def __init__(self, channel: Channel) -> None:
        super().__init__()
        self._channel = channel

    def emit(self, record: logging.LogRecord) -> None:
        self._channel.send({"log": (record.name, record.levelno, record.getMessage()[:LONGEST_LINE])})
