"""Memory that loading has left free goes back to the system."""

from __future__ import annotations

import ctypes
import sys

__all__ = ["return_memory"]

LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None


def return_memory() -> None:
    """Give it back: where bodies are swapped for days, glibc keeps half as much again in pieces."""
    if trim := getattr(LIBC, "malloc_trim", None):
        trim(0)
