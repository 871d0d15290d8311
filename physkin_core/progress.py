"""How far something that takes long has come, for commands: a line with the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

__all__ = ["Watch", "progress_line"]

Watch = Callable[[float], None]
"""Told how much has been done, from 0 to 1."""
PATIENCE = 1.0  # [s] what takes less is not worth a line


def progress_line(doing: str) -> Watch:
    """What keeps a line on standard error, if that is a terminal, until all is done. doing: "reading a.bvh"."""
    start = time.monotonic()

    def watch(share: float) -> None:
        taken = time.monotonic() - start
        if sys.stderr.isatty() and taken > PATIENCE:
            left = f", {_as_clock(taken / share - taken)} left" if share > 0 else ""
            line = f"{doing}: {share:.0%}{left}" if share < 1 else ""
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)

    return watch


def _as_clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}"
