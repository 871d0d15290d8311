"""How many steps a device takes a second."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import torch

__all__ = ["steady_rate"]

MEASURING = 8.0
"""Time [s] over which steps are counted; at most a thirtieth of the time that there is."""
WARM_UP_STEPS, STEPS_A_LOOK = 60, 20
"""Steps before, where they take no longer than that; and steps between two looks at the clock on a GPU."""


def steady_rate(steps: Iterator[int], seconds: float, device: torch.device) -> float:
    """Steps a second, of `steps` that are taken as they are asked for. seconds: that there are in all."""
    on_gpu, measuring = device.type == "cuda", min(MEASURING, seconds / 30)
    look = STEPS_A_LOOK if on_gpu else 1

    def rate(most: float) -> float:
        began, done, late = time.perf_counter(), 0, False
        while not late and done < most:
            for _ in range(look):
                next(steps)
                done += 1
            if on_gpu:
                torch.cuda.synchronize(device)
            late = time.perf_counter() - began > measuring
        return done / (time.perf_counter() - began)

    rate(WARM_UP_STEPS)
    return rate(math.inf)
