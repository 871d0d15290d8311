"""Reading NumPy's .npz files from outside: arrays of numbers and texts, nothing that would run code."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from physkin_core.file_reading import LARGEST_FILE, ContentError, read_bytes

__all__ = ["read_npz"]


def read_npz(path: Path, *, most: int = LARGEST_FILE) -> dict[str, np.ndarray]:
    """Arrays by name, objects left out. most: [bytes] of the file, and of what it unpacks to.

    Raises OSError, ContentError, zipfile.BadZipFile and ValueError where it cannot be read.
    """
    file, arrays = io.BytesIO(read_bytes(path, most=most)), {}
    with zipfile.ZipFile(file) as archive:
        if (size := sum(member.file_size for member in archive.infolist())) > most:
            raise ContentError(f"it has {size} bytes when unpacked, allowed are {most}")
    with np.load(file, allow_pickle=False) as members:
        for name in members:
            try:
                arrays[name] = members[name]
            except ValueError as error:
                if "allow_pickle" not in str(error):
                    raise
    return arrays
