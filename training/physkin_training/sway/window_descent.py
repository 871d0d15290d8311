"""Descent by windows of motion, the three frame rates in turn. On a GPU a step of each rate is recorded once.

A step is many kernels that each take microseconds: launched one by one, they would leave the GPU waiting.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch

from physkin_training.recorded_step import RecordedStep
from physkin_training.soap import Soap
from physkin_training.sway.windows import STRIDES, Window, Windows

__all__ = ["WindowDescent"]


class WindowDescent:
    """Lowers `loss` of so many windows a step. What `loss` reads is changed in place between steps, and it must not
    wait for the device."""

    def __init__(
        self, windows: Windows, optimiser: Soap, loss: Callable[[Window], torch.Tensor], *, windows_a_step: int
    ) -> None:
        self._windows, self._optimiser, self._loss = windows, optimiser, loss
        device = optimiser.steps.device
        self._walkers = torch.zeros(windows_a_step, dtype=torch.int64, device=device)
        self._steps = [
            RecordedStep(partial(self._descend, stride), device, clear=optimiser.zero_grad) for stride in STRIDES
        ]
        self._done = 0

    def step(self, walkers: torch.Tensor, learning_rate: float) -> None:
        """With the windows of these walkers (B,)."""
        for group in self._optimiser.param_groups:
            group["lr"].fill_(learning_rate)
        self._walkers.copy_(walkers)
        self._steps[self._done % len(STRIDES)]()
        self._done += 1
        self._optimiser.turn_bases(self._done)

    def _descend(self, stride: int) -> None:
        self._optimiser.zero_grad()
        self._loss(self._windows.at(self._walkers, stride=stride)).backward()
        self._optimiser.step()
