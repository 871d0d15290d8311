"""Imports the C++ module, `physkin_core._native`, and explains if it is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

try:
    import physkin_core._native as native
except ImportError as error:
    raise ImportError(
        f"physkin_core in {Path(__file__).parent} has no native module built for this Python ({error}). In a source "
        "folder, install with `pip install -e .`, or start Python elsewhere to use the installed package."
    ) from error

__all__ = ["as_float32", "native"]


def as_float32(array: ArrayLike) -> np.ndarray:
    """An array as the module takes it: float32, C-contiguous."""
    return np.ascontiguousarray(array, dtype=np.float32)
