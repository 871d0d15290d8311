"""Compiles Warp's kernels before they are needed: where its cache is empty, that takes as long as training for a minute
of all."""

from __future__ import annotations

import logging
import os
import time

import torch

from physkin_training.quiet_warp import wp

__all__ = ["compile_kernels"]

log = logging.getLogger(__name__)
NOTICED = 2.0
"""[s] Kernels that are in the cache are loaded in less."""
MOST_WORKERS = 4
"""More save nothing: each parses Warp's headers again."""


def compile_kernels(device: torch.device) -> None:
    """Compile all imported kernels of training that are not in Warp's cache: for the CPU, where meshes are checked, and
    for the device."""
    began = time.monotonic()
    workers = min(os.cpu_count() or 1, MOST_WORKERS)
    wp.load_module("physkin_training", sorted({"cpu", str(device)}), recursive=True, max_workers=workers)
    seconds = time.monotonic() - began
    if seconds > NOTICED:
        log.info("kernels compiled in %.0f s, once on this machine: they are not counted in --minutes", seconds)
