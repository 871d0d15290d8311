"""Progress of long commands: a line with the time that is left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

__all__ = ["Watch", "progress_line"]

Watch = Callable[[float], None]
"""Called with how much has been done, from 0 to 1."""
PATIENCE = 1.0  # [s] what takes less is not worth a line
LOG_EVERY = 30.0  # [s] between lines where standard error is no terminal


def progress_line(doing: str) -> Watch:
    """What keeps a line on standard error until all is done: in place if that is a terminal, else anew every half
    minute. doing: "reading a.bvh"."""
    start = time.monotonic()
    last = start

    def watch(share: float) -> None:
        nonlocal last
        now = time.monotonic()
        taken = now - start
        left = f", {_as_clock(taken / share - taken)} left" if share > 0 else ""
        line = f"{doing}: {share:.0%}{left}" if share < 1 else ""
        if not sys.stderr.isatty():
            if line and now - last > LOG_EVERY:
                last = now
                print(line, file=sys.stderr, flush=True)
        elif taken > PATIENCE:
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)

    return watch


def _as_clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}"
