"""Values from one process to another: pickled, and the bytes of their arrays in memory that both of them see.

Pickles run code, so a process must trust the one that it takes values from. Here that is its own child.
"""

from __future__ import annotations

import mmap
import os
import pickle
import tempfile
from itertools import accumulate
from typing import Any

import numpy as np

__all__ = ["array_bytes", "fetch", "shared_file", "store"]

LARGEST_VALUE = 1 << 30
"""[bytes] of all arrays of a value."""
ALIGNED = 64
"""[bytes] Each array begins at a multiple of this."""


def shared_file() -> int:
    """A descriptor of the shared memory, for `store` in one process and `fetch` in the other. Nothing else names it, so
    that it goes when both have; and it has its full size, which takes no memory, so that no limit on files applies."""
    if hasattr(os, "memfd_create"):
        file = os.memfd_create("physkin")
    else:
        with tempfile.TemporaryFile() as temporary:
            file = os.dup(temporary.fileno())
    os.ftruncate(file, LARGEST_VALUE)
    return file


def store(value: object, file: int) -> tuple[bytes, list[int]]:
    """Put the arrays of a value into the shared memory. Returns what `fetch` needs besides. Raises ValueError where
    they are too large, and what `pickle` raises for what it cannot write."""
    pickled, arrays = _parts(value)
    sizes = [array.nbytes for array in arrays]
    *starts, total = _starts(sizes)
    if total > LARGEST_VALUE:
        raise ValueError(f"what was read takes {total} bytes, allowed are {LARGEST_VALUE}; use a smaller file")
    if total:
        with mmap.mmap(file, total) as memory:
            for start, array in zip(starts, arrays):
                memory[start : start + array.nbytes] = array
    return pickled, sizes


def fetch(pickled: bytes, sizes: list[int], file: int) -> Any:
    """The value that was stored; the shared memory is empty afterwards.

    Its arrays are parts of one block, which is read in one call that does without the interpreter's lock: frames are
    due meanwhile, and a thread that hands the lock over for each array may lose its core in between.
    """
    *starts, total = _starts(sizes)
    block = np.empty(total, dtype=np.uint8)
    os.preadv(file, [block], 0)
    os.ftruncate(file, 0)
    os.ftruncate(file, LARGEST_VALUE)
    return pickle.loads(pickled, buffers=[block[start : start + size] for start, size in zip(starts, sizes)])


def array_bytes(value: object) -> int:
    """[bytes] of all arrays of a value, each counted once."""
    return sum(array.nbytes for array in _parts(value)[1])


def _parts(value: object) -> tuple[bytes, list[memoryview]]:
    buffers: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    return pickled, [buffer.raw() for buffer in buffers]


def _starts(sizes: list[int]) -> list[int]:
    """Where each array begins, and where the last one ends."""
    return list(accumulate((-(-size // ALIGNED) * ALIGNED for size in sizes), initial=0))
