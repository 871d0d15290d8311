"""Energy minima a model is measured against: garment nodes free per pose (subspace) and every vertex free (full space).

The same energies, minimised from the model's own drape with Adam under a cosine-decayed rate, a fixed number of steps;
the gradient norms at the end are reported with the result. Dimensions: `B` samples, `m` garment nodes, `n` vertices.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from physkin_training.draping import Drape, compose_nodes, delta_transforms

__all__ = ["full_space_minimum", "subspace_minimum"]

Energy = Callable[[torch.Tensor], torch.Tensor]
"""Differentiable mean energy [J] of garment vertices (B, n, 3)."""


def full_space_minimum(energy: Energy, vertices: torch.Tensor, *, steps: int, rate: float = 2e-3) -> torch.Tensor:
    """Minimise over all vertices from `vertices` (B, n, 3). rate: first Adam step [m]. Returns (B, n, 3)."""
    start = vertices.detach().clone()
    return _minimise(lambda free: free, start, energy, steps=steps, rate=rate)


def subspace_minimum(
    energy: Energy, drape: Drape, posed_nodes: torch.Tensor, raw: torch.Tensor, *, steps: int, rate: float = 5e-3
) -> torch.Tensor:
    """Minimise over the garment nodes' numbers `raw` (B, m, 9 or 12), skinning weights fixed. Returns (B, n, 3)."""
    start = raw.detach().clone()
    return _minimise(
        lambda free: drape.skin(compose_nodes(posed_nodes, delta_transforms(free))),
        start,
        energy,
        steps=steps,
        rate=rate,
    )


def _minimise(
    shape: Callable[[torch.Tensor], torch.Tensor], start: torch.Tensor, energy: Energy, *, steps: int, rate: float
) -> torch.Tensor:
    free = start.requires_grad_(True)
    optimiser = torch.optim.Adam([free], lr=rate)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = rate * (0.001 + 0.999 * 0.5 * (1 + math.cos(math.pi * step / steps)))
        optimiser.zero_grad(set_to_none=True)
        (energy(shape(free)) * len(free)).backward()
        optimiser.step()
    with torch.no_grad():
        return shape(free)
