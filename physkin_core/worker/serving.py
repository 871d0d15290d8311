"""The worker's side: limits that this process is put under, and requests that it answers until nobody asks any more.

What is promised: such a process takes no more memory and time than it may, writes no file, leaves no core dump, and
ends with whoever started it. It opens no socket of its own, but nothing would keep code that has taken it over from
opening one: it contains accidents and bombs, not an attacker who runs code.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import resource
import select
import signal
import sys
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import Any

from physkin_core.worker.shared_arrays import store

__all__ = ["end_with", "limit_resources", "serve"]

MIB = 1 << 20
LONGEST_LINE = 1000
"""Letters of what is logged."""
POLITENESS = 10
"""Others, whose frames are due, get a core first."""
OVERTIME = 5
"""[s] after its time the process ends by itself, where nobody ended it."""


def serve(answer: Callable[[Any], object]) -> None:
    """Answer requests until the other end goes. Arguments of the command line: `Worker` gives them."""
    *given, seconds = sys.argv[1:]
    requests_end, answers_end, arrays, memory = map(int, given)
    requests, answers = Connection(requests_end, writable=False), Connection(answers_end, readable=False)
    Thread(target=end_with, args=(answers_end,), daemon=True).start()
    limit_resources(memory)
    warnings.simplefilter("ignore")  # what is worth saying is in what is loaded
    logger = logging.getLogger("physkin_core")
    logger.setLevel(logging.INFO)
    logger.addHandler(_Forwarding(answers))
    logger.propagate = False
    with contextlib.suppress(EOFError, BrokenPipeError):
        answers.send(("ready", None))
        while True:
            request = requests.recv()
            signal.setitimer(signal.ITIMER_REAL, float(seconds) + OVERTIME)
            answers.send(_answered(answer, request, arrays))
            signal.setitimer(signal.ITIMER_REAL, 0)


def _answered(answer: Callable[[Any], object], request: object, arrays: int) -> tuple[str, object]:
    """What became of a request, and what there is to say of it; `Worker` knows the words."""
    try:
        return "answer", store(answer(request), arrays)
    except Exception as error:
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return "memory", None
        if isinstance(error, ValueError | OSError):
            return "refused", str(error)
        # a fault of ours, or of a library: this request's alone
        return "failed", f"{type(error).__name__}: {error}"[:LONGEST_LINE]


def limit_resources(memory: int) -> None:
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


def end_with(answers: int) -> None:
    """End this process when nobody reads from a pipe any more, however that came, and whatever is being done here."""
    poll = select.poll()
    poll.register(answers, select.POLLERR)
    poll.poll()
    os._exit(0)


class _Forwarding(logging.Handler):
    """Says what is logged to the other end."""

    def __init__(self, answers: Connection) -> None:
        super().__init__()
        self._answers = answers

    def emit(self, record: logging.LogRecord) -> None:
        self._answers.send(("log", (record.name, record.levelno, record.getMessage()[:LONGEST_LINE])))
