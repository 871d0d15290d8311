"""Windows of motion that a sway network learns from: 60, 30 or 15 frames a second, every target 15.

Dimensions: `B` windows, `T` frames of a window, `t` of them kept, `r` shapes.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from physkin_training.dynamics.scenes import RATE_HZ
from physkin_training.sway.modules import Features, SwayModule
from physkin_training.sway.walkers import KEPT_EVERY, Walkers

__all__ = ["STRIDES", "Window", "Windows"]

STRIDES = (1, 2, 4)
"""Frames of 60 a second from one that the network sees to the next."""
WARM_UP = 1 / 5
"""Share of a window in which states forget that they began at rest: it does not count, where the motion had begun
before."""
FROM_THE_START = 0.1
"""Share of the windows that begin where the motion does."""


@dataclass(frozen=True)
class Window:
    """Drive (B, T, f) and pose (B, T, p), frames of `step` [s], codes (B, c); every `every`-th frame has coefficients
    (B, t, r), which count as much as `share` (B, t) says. walker (B,), and its `last` frame (B,)."""

    drive: torch.Tensor
    pose: torch.Tensor
    code: torch.Tensor
    step: float
    every: int
    coefficients: torch.Tensor
    share: torch.Tensor
    walker: torch.Tensor
    last: torch.Tensor

    def hidden(self, network: SwayModule) -> torch.Tensor:
        """What the network's last layer reads, (B, t, h)."""
        return network.hidden(self.drive, self.pose, self.code, self.step, every=self.every)

    def swing(self, coefficients: torch.Tensor) -> torch.Tensor:
        """How far coefficients (B, t, r) go to and fro in the frames that count: their standard deviation (B, r)."""
        share = self.share[..., None] / self.share.sum(dim=1).clamp_min(1)[:, None, None]
        mean = (share * coefficients).sum(dim=1, keepdim=True)
        return ((share * (coefficients - mean) ** 2).sum(dim=1) + 1).sqrt()

    def mean(self, errors: torch.Tensor) -> torch.Tensor:
        """Of errors (B, t), those that count."""
        return (errors * self.share).sum() / self.share.sum().clamp_min(1)


class Windows:
    """Draws windows of walkers, all of so many kept frames, or all that there are. generator: of the CPU."""

    def __init__(self, walkers: Walkers, features: Features, generator: torch.Generator, *, kept: int) -> None:
        self._walkers, self._features, self._generator = walkers, features, generator
        self._kept = min(kept, walkers.valid.shape[1])
        self._span = KEPT_EVERY * (self._kept - 1)

    def drawn(self, walker: torch.Tensor) -> torch.Tensor:
        """Walkers (B,) and the frames that their windows begin with, as one (2, B) of the CPU."""
        count = len(walker)
        starts = (self._walkers.positions.shape[1] - 1 - self._span) // KEPT_EVERY + 1
        start = torch.randint(starts, (count,), generator=self._generator) * KEPT_EVERY
        return torch.stack([walker, start * (torch.rand(count, generator=self._generator) >= FROM_THE_START)])

    def at(self, drawn: torch.Tensor, *, stride: int) -> Window:
        """The windows that were drawn, (2, B) on the walkers' device. Nothing of this waits for the device.

        stride: frames of 60 a second from one that the network sees to the next.
        """
        known, kept, (walker, start) = self._walkers, self._kept, drawn
        frames = start[:, None] + torch.arange(0, self._span + 1, stride, device=drawn.device)
        row = walker[:, None]
        step = stride / RATE_HZ
        motion = (known.positions, known.place, known.turn, known.gravity)
        drive, pose = self._features(*(part[row, frames] for part in motion), step)
        every = KEPT_EVERY // stride
        targets = frames[:, ::every] // KEPT_EVERY
        share = known.valid[row, targets].float()
        share[:, : int(WARM_UP * kept)] *= (start == 0).float()[:, None]
        return Window(
            *(drive, pose, known.codes[known.body[walker]], step, every),
            coefficients=known.coefficients[row, targets].float(),
            share=share,
            walker=walker,
            last=frames[:, -1],
        )
