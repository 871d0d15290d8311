"""Imports Warp without its banner, and without a line for each module that it compiles or loads."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch
import warp as wp

__all__ = ["wp"]


@contextmanager
def _unheard_errors() -> Iterator[None]:
    """What is written to standard error meanwhile, by C++ too, is lost."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


wp.config.log_level = wp.LOG_ERROR
if not torch.cuda.is_available():
    with _unheard_errors():  # it warns of a driver that is not there; physkin doctor says so, too
        wp.init()
