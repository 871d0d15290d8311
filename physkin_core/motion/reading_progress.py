"""How far reading a motion has come, for commands."""

from __future__ import annotations

from pathlib import Path

from physkin_core.progress import Watch, progress_line

__all__ = ["reading_progress"]


def reading_progress(motion: str | Path) -> Watch:
    """What keeps a line on standard error, if that is a terminal, until all is read."""
    return progress_line(f"reading {motion}")
