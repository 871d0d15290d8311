"""The minutes that a user gives a command: how many are left, and how many a part of the work may take."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

__all__ = ["TimeBudget"]

LEAST = 1e-6


class TimeBudget:
    """minutes: from now until the command has to be done; infinite by default. clock: seconds, by default those on the
    wall."""

    def __init__(self, minutes: float = math.inf, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._began = clock, clock()
        self.seconds = 60 * minutes

    @property
    def spent(self) -> float:
        """Seconds since it began."""
        return self._clock() - self._began

    @property
    def left(self) -> float:
        """Seconds, below 0 when the time is up."""
        return self.seconds - self.spent

    def timed(self, work: Callable[[], Any]) -> tuple[Any, float]:
        """What the work returns, and the seconds it took."""
        began = self.spent
        result = work()
        return result, max(self.spent - began, LEAST)

    def uncounted(self, work: Callable[[], None]) -> None:
        """Do work that takes nothing of the time."""
        _, seconds = self.timed(work)
        self._began += seconds
