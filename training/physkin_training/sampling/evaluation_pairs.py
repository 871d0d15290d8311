"""What a model is measured on: (body, pose) pairs, drawn uniformly or frame by frame from motion.

Dimensions: `P` pairs, `d` degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch

from physkin_core.motion.motion import Motion
from physkin_core.rig.rig import Rig
from physkin_training.sampling.pose_sampling import PoseSampler

__all__ = ["Pairs", "motion_pairs", "uniform_pairs"]


@dataclass(frozen=True)
class Pairs:
    """Joint positions (P, d) [rad], gravity (P, 3) and body indices (P,), float32 and int64, on the CPU."""

    positions: torch.Tensor
    gravity: torch.Tensor
    body: torch.Tensor

    def __len__(self) -> int:
        return len(self.body)

    def __getitem__(self, chosen: torch.Tensor) -> Pairs:
        return Pairs(self.positions[chosen], self.gravity[chosen], self.body[chosen])

    @classmethod
    def joined(cls, parts: Sequence[Pairs]) -> Pairs:
        """All pairs of the parts, one part after the other."""
        return cls(*(torch.cat([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def spread(self, count: int) -> Pairs:
        """`count` of the pairs, evenly spread over them (at most all)."""
        return self[torch.linspace(0, len(self) - 1, min(count, len(self))).round().long()]


def uniform_pairs(rig: Rig, *, bodies: int, poses: int, seed: int, upright: bool) -> Pairs:
    """bodies x poses pairs: every joint uniform over its limits, bodies in turn; the same for a seed on any device.

    upright: whether all roots stand; else all lean, any way, by up to `LARGEST_TILT`.
    """
    sampler = PoseSampler(rig, torch.device("cpu"), upright=float(upright))
    positions, gravity = sampler.sample(bodies * poses, 1.0, generator=torch.Generator().manual_seed(seed))
    return Pairs(positions, gravity, torch.arange(bodies * poses) % bodies)


def motion_pairs(motion: Motion, rig: Rig, *, bodies: int) -> Pairs:
    """All frames of a clip on the first body, then on the second, and so on.

    Raises MotionError when the clip moves none of the rig's joints.
    """
    positions = torch.as_tensor(motion.positions_for(rig)).repeat(bodies, 1)
    gravity = torch.as_tensor(motion.gravity).repeat(bodies, 1)
    return Pairs(positions, gravity, torch.arange(bodies).repeat_interleave(motion.frame_count))
