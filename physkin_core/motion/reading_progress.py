"""How far reading a motion has come, for commands."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

__all__ = ["Watch", "reading_progress"]

Watch = Callable[[float], None]
"""Told how much of a motion has been read, from 0 to 1."""
PATIENCE = 1.0  # [s] reading that takes less is not worth a line


def reading_progress(motion: str | Path) -> Watch:
    """What keeps a line on standard error, if that is a terminal, until all is read."""
    start = time.monotonic()

    def watch(share: float) -> None:
        if sys.stderr.isatty() and time.monotonic() - start > PATIENCE:
            line = f"reading {motion}: {share:.0%}" if share < 1 else ""
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)

    return watch
