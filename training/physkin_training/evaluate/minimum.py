"""The energy's minimum over the garment nodes' numbers, free per pose (the full space has `full_space_solver`).

The same energies, minimised with Adam under a cosine-decayed rate, a fixed number of steps.
Dimensions: `B` samples, `m` garment nodes, `n` vertices.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from physkin_training.networks.draping import Drape, RestShape, compose_nodes, delta_transforms

__all__ = ["subspace_minimum"]

STEPS, RATE = 2000, 5e-3
"""Steps of Adam, and the rate of the first."""
Energy = Callable[[torch.Tensor], torch.Tensor]
"""Differentiable mean energy [J] of garment vertices (B, n, 3)."""


def subspace_minimum(
    energy: Energy,
    drape: Drape,
    posed_nodes: torch.Tensor,
    raw: torch.Tensor,
    *,
    rest: RestShape | None = None,
    detail: torch.Tensor | None = None,
) -> torch.Tensor:
    """Vertices (B, n, 3) [m], detached, of the minimum over the garment nodes' numbers `raw` (B, m, 12), skinning
    weights fixed. rest: of the samples, default the template. detail: offsets of detail nodes (B, D, 3) [m] that stay
    as they are, so that the minimum is below the model's own drape, which they belong to; default none."""
    free = raw.detach().clone().requires_grad_(True)
    optimiser = torch.optim.Adam([free], lr=RATE)

    def shape() -> torch.Tensor:
        return drape.skin(compose_nodes(posed_nodes, delta_transforms(free)), rest, detail)

    for step in range(STEPS):
        optimiser.param_groups[0]["lr"] = RATE * (0.001 + 0.999 * 0.5 * (1 + math.cos(math.pi * step / STEPS)))
        (free.grad,) = torch.autograd.grad(energy(shape()) * len(free), free)
        optimiser.step()
    return shape().detach()
