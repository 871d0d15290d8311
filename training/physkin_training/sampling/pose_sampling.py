"""Poses of training and evaluation: uniform in a box around the A-pose that, in training, grows to the joint limits,
under gravity of tilted roots.

Paper: Training. Dimensions: `B` samples, `d` degrees of freedom.
"""

from __future__ import annotations

import math

import torch

from physkin_core.rig.rig import Rig
from physkin_training.config import PoseConfig

__all__ = ["PoseSampler", "pose_range"]

FIRST_RANGE = 0.1


def pose_range(progress: float, growth: float) -> float:
    """Share of the joint limits in use: from 10 % in steps of 10 % to all of them at `growth` of the run.

    progress: 0 to 1. growth: share of the run after which the full range is reached.
    """
    if growth <= 0:
        return 1.0
    return min(1.0, FIRST_RANGE * (1 + math.floor(9 * min(progress / growth, 1.0))))


class PoseSampler:
    """Draws joint positions (B, d) [rad] and gravity directions (B, 3) on a device.

    upright: share of samples whose root stands upright; the others lean by up to `largest_tilt` [rad] any way.
    """

    @classmethod
    def configured(cls, config: PoseConfig, rig: Rig, device: torch.device) -> PoseSampler:
        """The sampler of a training configuration."""
        return cls(rig, device, upright=config.upright, largest_tilt=math.radians(config.largest_tilt_degrees))

    def __init__(self, rig: Rig, device: torch.device, *, upright: float, largest_tilt: float) -> None:
        def tensor(values) -> torch.Tensor:
            return torch.as_tensor(values.copy(), dtype=torch.float32, device=device)

        self.lower, self.upper, self.rest = tensor(rig.lower), tensor(rig.upper), tensor(rig.rest)
        self.upright = upright
        self.largest_tilt = largest_tilt

    def sample(
        self, count: int, share: torch.Tensor | float, *, generator: torch.Generator | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Joint positions (count, d) and gravity directions (count, 3).

        share: part of the joint limits and of the largest tilt in use, 0 to 1 (a tensor may change). generator: of the
        sampler's device; default that device's own.
        """

        def uniform(*shape: int) -> torch.Tensor:
            return torch.rand(*shape, device=self.lower.device, generator=generator)

        within = uniform(count, len(self.lower))
        reach_down, reach_up = (self.lower - self.rest) * share, (self.upper - self.rest) * share
        positions = self.rest + reach_down + within * (reach_up - reach_down)
        tilt = uniform(count) * self.largest_tilt * share
        tilt = torch.where(uniform(count) < self.upright, torch.zeros_like(tilt), tilt)
        azimuth = uniform(count) * (2 * torch.pi)
        gravity = torch.stack([tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), -tilt.cos()], dim=1)
        return positions, gravity
