"""Windows of motion that a sway network learns from: whole motions of walkers, 60, 30 or 15 frames a second, every
target 15.

Dimensions: `B` windows, `T` frames of a window, `t` of them with a target, `r` shapes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import nn

from physkin_training.dynamics.scenes import RATE_HZ
from physkin_training.sway.modules import Features, SwayModule
from physkin_training.sway.walkers import KEPT_EVERY, Walkers

__all__ = ["STRIDES", "Window", "Windows"]

STRIDES = (1, 2, 4)
"""Frames of 60 a second from one that the network sees to the next."""
OTHER_BODY, OTHER_JOINTS = 0.5, 0.15
"""How far the body and the pose of a blurred window are from the real ones: in standard deviations of the body code,
and in halves of each joint's range."""
STILL = 0.2
"""Below this share of the mean square movement, cloth that moves less counts no more for it."""


@dataclass(frozen=True)
class Window:
    """Drive (B, T, f) and pose (B, T, p), frames of `step` [s], codes (B, c); every `every`-th frame has coefficients
    (B, t, r), and counts or not, `share` (B, t). walker (B,)."""

    drive: torch.Tensor
    pose: torch.Tensor
    code: torch.Tensor
    step: float
    every: int
    coefficients: torch.Tensor
    share: torch.Tensor
    walker: torch.Tensor

    def hidden(self, network: SwayModule) -> torch.Tensor:
        """What the network's last layer reads, (B, t, h)."""
        return network.hidden(self.drive, self.pose, self.code, self.step, every=self.every)

    def blurred(self, *, sharp: torch.Tensor | None = None) -> Window:
        """The same targets for another body in another pose, which stay the same throughout a window. There are few
        walkers, and a network that can tell them apart learns them by heart. sharp: (B,) bool, windows that stay as
        they are."""
        joints = self.pose.shape[2] - 3
        share = torch.ones_like(self.code[:, :1]) if sharp is None else (~sharp[:, None]).float()
        away = OTHER_JOINTS * share[:, None] * torch.randn_like(self.pose[:, :1, :joints])

        def moved(numbers: torch.Tensor) -> torch.Tensor:
            return numbers + nn.functional.pad(away, (0, numbers.shape[2] - joints))

        code = self.code + OTHER_BODY * share * torch.randn_like(self.code)
        return replace(self, drive=moved(self.drive), pose=moved(self.pose), code=code)

    def swing(self, coefficients: torch.Tensor) -> torch.Tensor:
        """How far coefficients (B, t, r) go to and fro in the frames that count: their standard deviation (B, r)."""
        return (self._variance(coefficients) + 1).sqrt()

    def mean(self, errors: torch.Tensor) -> torch.Tensor:
        """Of errors (B, t), those that count."""
        return (errors * self.share).sum() / self.share.sum().clamp_min(1)

    def evenly(self) -> torch.Tensor:
        """How much the errors of each window count (B,), 1 on average. They count more if its cloth moves less, so that
        a gentle swing is learnt as well as a leap."""
        moved = self._variance(self.coefficients).sum(dim=1)
        weights = 1 / (moved + STILL * moved.mean()).clamp_min(1e-12)
        return weights / weights.mean()

    def _variance(self, coefficients: torch.Tensor) -> torch.Tensor:
        share = self.share[..., None] / self.share.sum(dim=1).clamp_min(1)[:, None, None]
        mean = (share * coefficients).sum(dim=1, keepdim=True)
        return (share * (coefficients - mean) ** 2).sum(dim=1)


class Windows:
    """The motions of walkers as windows."""

    def __init__(self, walkers: Walkers, features: Features) -> None:
        self._walkers, self._seen = walkers, {}
        motion = (walkers.positions, walkers.place, walkers.turn, walkers.gravity)
        for stride in STRIDES:
            last = (walkers.positions.shape[1] - 1) // KEPT_EVERY * KEPT_EVERY
            frames = slice(0, last + 1, stride)
            self._seen[stride] = features(*(part[:, frames] for part in motion), stride / RATE_HZ)

    def at(self, walker: torch.Tensor, *, stride: int) -> Window:
        """Windows of walkers (B,), on their device. This does not wait for the device.

        stride: frames of 60 a second from one that the network sees to the next.
        """
        known, (drive, pose) = self._walkers, self._seen[stride]
        return Window(
            *(drive[walker], pose[walker], known.codes[known.body[walker]], stride / RATE_HZ, KEPT_EVERY // stride),
            coefficients=known.coefficients[walker].float(),
            share=known.valid[walker].float(),
            walker=walker,
        )
