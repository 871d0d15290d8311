"""Timing of several things in turns, so that whatever else the machine does hits all of them alike."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np

__all__ = ["Timing", "time_in_turns"]


@dataclass(frozen=True)
class Timing:
    """Microseconds a call: the fastest, the median and the 99th percentile of `count` calls."""

    min: float
    p50: float
    p99: float
    count: int


def time_in_turns(
    calls: Mapping[str, Callable[[], object]],
    *,
    rounds: int,
    repeats: int = 5,
    before_each: Callable[[], object] | None = None,
) -> dict[str, Timing]:
    """Time every call `rounds` x `repeats` times, round robin.

    A turn starts with one call that is not timed, so that the timed ones find what the call itself leaves in caches.
    before_each: run, untimed, before every timed call (to empty the caches); the untimed call is left out then.
    Each sample holds about 0.1 µs of Python.
    """
    samples: dict[str, list[int]] = {name: [] for name in calls}
    collecting = gc.isenabled()
    gc.disable()
    try:
        for _ in range(rounds):
            for name, call in calls.items():
                if before_each is None:
                    call()
                for _ in range(repeats):
                    if before_each is not None:
                        before_each()
                    start = perf_counter_ns()
                    call()
                    samples[name].append(perf_counter_ns() - start)
    finally:
        if collecting:
            gc.enable()
    figures = {name: np.percentile(np.array(taken) / 1e3, [0, 50, 99]) for name, taken in samples.items()}
    return {name: Timing(*map(float, figures[name]), len(samples[name])) for name in calls}
