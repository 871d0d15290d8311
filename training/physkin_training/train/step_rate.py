"""How many steps fit into a given time, from steps that are timed and undone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

import torch

__all__ = ["steps_within"]

LATE = 0.7
"""Share of a run at which steps are as long as in most of it: full range, influences pruned."""
MEASURING = 8.0
"""Time [s] over which the rate of steps is measured; at most a thirtieth of the run's."""
WARM_UP_STEPS, STEPS_A_LOOK = 60, 20
FEWEST_STEPS = 10
PARTS = 1000
"""Steps of the run in which rates are measured."""
USED = 0.97
"""Share of the time that steps fill; the rest is for measuring the average, and for rates that were too high."""


def steps_within(
    seconds: float,
    take_steps: Callable[[float, int], Iterator[int]],
    *,
    full_encoding: float,
    device: torch.device,
) -> tuple[int, float]:
    """Steps of a run that takes `seconds` from now on, measuring included, and their rate [steps/s].

    take_steps: see `Trainer.take_steps`. full_encoding: share of the run from which on steps are those of its end.
    Raises ValueError when the time is too short for any.
    """
    began = time.perf_counter()
    measuring = min(MEASURING, seconds / 30)
    end = min(full_encoding, 1 - 1 / PARTS)
    late = _steady_rate(take_steps(LATE, PARTS), measuring, device)
    last = _steady_rate(take_steps(end, PARTS), measuring / 4, device)
    rate = 1 / (end / late + (1 - end) / last)
    steps = int(rate * (seconds - (time.perf_counter() - began)) * USED)
    if steps < FEWEST_STEPS:
        raise ValueError(
            f"{seconds / 60:g} minutes are too short for a run of {FEWEST_STEPS} steps at {rate:.1f} a second"
        )
    return steps, rate


def _steady_rate(taken: Iterator[int], seconds: float, device: torch.device) -> float:
    """Steps a second of those `taken`, over `seconds` after a warm-up."""
    on_gpu = device.type == "cuda"
    look = STEPS_A_LOOK if on_gpu else 1

    def rate(most: float) -> float:
        began, done, late = time.perf_counter(), 0, False
        while not late and done < most:
            for _ in range(look):
                next(taken)
                done += 1
            if on_gpu:
                torch.cuda.synchronize(device)
            late = time.perf_counter() - began > seconds
        return done / (time.perf_counter() - began)

    rate(WARM_UP_STEPS)
    return rate(math.inf)
