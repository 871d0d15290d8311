"""Argument types of the tools' command lines."""

from __future__ import annotations

import argparse
import math

__all__ = ["positive"]


def positive(text: str) -> float:
    """A positive, finite number."""
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be positive and finite, got {text}")
    return value
