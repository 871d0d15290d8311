"""Argument types of the command lines of replay and tools."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from physkin_core.output_file import check_folder

__all__ = ["file_to_write", "positive", "whole_number"]


def positive(text: str) -> float:
    """A positive, finite number."""
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be positive and finite, got {text}")
    return value


def whole_number(least: int) -> Callable[[str], int]:
    """A whole number that is not less than `least`."""

    def number(text: str) -> int:
        value = int(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"must be at least {least}, got {text}")
        return value

    return number


def file_to_write(text: str) -> Path:
    """A file that can be written: told at once, not after the work that it is for."""
    path = Path(text)
    try:
        check_folder(path)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return path
