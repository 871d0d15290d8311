"""Reading NumPy's .npz files from outside: arrays of numbers and texts, nothing that would run code."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from physkin_core.file_reading import LARGEST_FILE, ContentError, read_bytes, shown

__all__ = ["read_npz"]


def read_npz(path: Path, *, most: int = LARGEST_FILE) -> dict[str, np.ndarray]:
    """Arrays by name, objects left out. What it declares is compared with what it holds before memory is taken for it.

    most: [bytes] of the file, and of what it unpacks to.
    Raises OSError, ContentError, zipfile.BadZipFile and ValueError where it cannot be read.
    """
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(read_bytes(path, most=most))) as archive:
        if (size := sum(member.file_size for member in archive.infolist())) > most:
            raise ContentError(f"it has {size} bytes when unpacked, allowed are {most}")
        for member in archive.infolist():
            file = io.BytesIO(archive.read(member))
            read_header = {(1, 0): npy.read_array_header_1_0}.get(npy.read_magic(file), npy.read_array_header_2_0)
            shape, _, dtype = read_header(file)
            if dtype.hasobject:
                continue
            if math.prod(shape) * dtype.itemsize > len(file.getbuffer()) - file.tell():
                raise ContentError(f"{shown(member.filename)} is truncated: it declares the shape {shown(shape)}")
            file.seek(0)
            arrays[member.filename.removesuffix(".npy")] = npy.read_array(file, allow_pickle=False)
    return arrays
