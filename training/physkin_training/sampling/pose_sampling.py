"""Poses of training and evaluation: everyday ones, and ones uniform in a box around the A-pose that, in training, grows
to the joint limits; under gravity of tilted and of accelerated roots.

Paper: Training. Dimensions: `B` samples, `d` degrees of freedom.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from physkin_core.rig.rig import Rig
from physkin_training.sampling.everyday_poses import EverydayPoses

__all__ = ["LARGEST_TILT", "PoseSampler", "pose_range"]

FIRST_RANGE = 0.1
LARGEST_ACCELERATION = 2.0
"""Of the root, in units of gravity: cloth feels at most three times its weight."""
LARGEST_TILT = math.radians(110)
"""[rad] Roots lean by up to this."""
EVERYDAY, ACCELERATED, UPRIGHT = 0.6, 0.3, 0.5
"""In training: shares of everyday poses and of accelerated roots, and, of the other poses, of roots that stand."""


def pose_range(progress: float, growth: float) -> float:
    """Share of the joint limits in use: from 10 % in steps of 10 % to all of them at `growth` of the run.

    progress: 0 to 1. growth: share of the run after which the full range is reached.
    """
    if growth <= 0:
        return 1.0
    return min(1.0, FIRST_RANGE * (1 + math.floor(9 * min(progress / growth, 1.0))))


class PoseSampler:
    """Draws joint positions (B, d) [rad] and effective gravity (B, 3), in units of gravity, on a device.

    everyday: share of samples that have an everyday pose; the others' is uniform in the limits. Of these, `upright`
    have an upright root, the others lean by up to `LARGEST_TILT` any way. accelerated: share of all samples whose root
    is accelerated, any way, by up to twice gravity; what cloth then feels is gravity less the acceleration.
    """

    @classmethod
    def of_training(cls, rig: Rig, device: torch.device) -> PoseSampler:
        """The sampler that training draws from."""
        return cls(rig, device, everyday=EVERYDAY, accelerated=ACCELERATED, upright=UPRIGHT)

    def __init__(
        self, rig: Rig, device: torch.device, *, upright: float, everyday: float = 0.0, accelerated: float = 0.0
    ) -> None:
        def tensor(values) -> torch.Tensor:
            return torch.as_tensor(np.array(values), dtype=torch.float32, device=device)

        self.lower, self.upper, self.rest = tensor(rig.lower), tensor(rig.upper), tensor(rig.rest)
        self.upright, self.everyday, self.accelerated = upright, everyday, accelerated
        self._everyday_poses = EverydayPoses(rig, device) if everyday > 0 else None
        self._down = tensor([0.0, 0.0, -1.0])

    def sample(
        self, count: int, share: torch.Tensor | float, *, generator: torch.Generator | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Joint positions (count, d) and effective gravity (count, 3): a direction where the root is not accelerated.

        share: part of the joint limits, of the way to everyday poses, of the largest tilt and of the largest
        acceleration in use, 0 to 1 (a tensor may change). generator: of the sampler's device, default its own.
        """

        def uniform(*shape: int) -> torch.Tensor:
            return torch.rand(*shape, device=self.lower.device, generator=generator)

        within = uniform(count, len(self.lower))
        reach_down, reach_up = (self.lower - self.rest) * share, (self.upper - self.rest) * share
        positions = self.rest + reach_down + within * (reach_up - reach_down)
        tilt = uniform(count) * LARGEST_TILT * share
        tilt = torch.where(uniform(count) < self.upright, torch.zeros_like(tilt), tilt)
        azimuth = uniform(count) * (2 * torch.pi)
        gravity = torch.stack([tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), -tilt.cos()], dim=1)
        if self._everyday_poses is not None:
            poses, downs = self._everyday_poses.sample(count, generator=generator)
            chosen = uniform(count, 1) < self.everyday
            positions = torch.where(chosen, self.rest + share * (poses - self.rest), positions)
            gravity = torch.where(chosen, _unit(share * downs + (1 - share) * self._down), gravity)
        if self.accelerated > 0:
            way = _unit(torch.randn(count, 3, device=self.lower.device, generator=generator))
            effective = gravity - LARGEST_ACCELERATION * share * uniform(count, 1) * way
            gravity = torch.where(uniform(count, 1) < self.accelerated, effective, gravity)
        return positions, gravity


def _unit(vectors: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(vectors, dim=1)
