"""Shared memory that Fast DDS processes leave in /dev/shm when they are killed.

Whether a segment is in use is read from the memory maps of the processes that can be seen: those of another container
that shares /dev/shm cannot. So nothing is deleted unasked.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

__all__ = ["SHARED_MEMORY", "leftovers", "remove_shared_memory", "shared_memory_of"]

SHARED_MEMORY = Path("/dev/shm")
"""Where Fast DDS puts it."""
SEGMENT = re.compile(r"fastrtps_\w+")


def shared_memory_of(pid: int | str) -> set[str]:
    """Names of the Fast DDS segments and ports that a process has open; none if it may not be looked into."""
    try:
        maps = Path(f"/proc/{pid}/maps").read_text(errors="replace")
    except OSError:
        return set()
    return set(re.findall(rf"{SHARED_MEMORY}/(fastrtps_\w+)", maps))


def remove_shared_memory(names: Iterable[str]) -> int:
    """Delete what killed processes had open and no living one has. Returns the number of bytes that were freed."""
    freed = 0
    for name in _unused(set(names)):
        for file in (name, f"{name}_el", f"sem.{name}_mutex"):
            path = SHARED_MEMORY / file
            try:
                freed += path.stat().st_size
                path.unlink()
            except OSError:
                continue
    return freed


def leftovers() -> set[str]:
    """Names of this user's Fast DDS segments and ports that no process has open."""
    names = set()
    try:
        entries = list(os.scandir(SHARED_MEMORY))
    except OSError:
        return names
    for entry in entries:
        if SEGMENT.fullmatch(entry.name) and not entry.name.endswith("_el"):
            try:
                own = entry.stat().st_uid == os.getuid()
            except OSError:  # gone meanwhile
                continue
            if own:
                names.add(entry.name)
    return _unused(names) if names else names


def _unused(names: set[str]) -> set[str]:
    living = [path.name for path in Path("/proc").glob("[0-9]*")]
    return names.difference(*map(shared_memory_of, living))
