"""Principal shapes of simulated offsets: a few directions that hold nearly all that cloth does.

They are the principal axes in a metric of two parts: the mass that an error moves, and the energy that it costs. With
mass alone, cloth would be in nearly the right place, but strained.

Dimensions: `N` offsets, `a = 12 m` numbers of garment nodes, `r` shapes. Kilograms, metres, joules.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch

__all__ = ["Shapes", "principal_shapes"]

COSTLY = 0.15
"""How much the part of cost counts, against that of mass."""
UNIT = 0.01
"""Coefficients are in hundredths of the spread of all offsets."""
LEAST_VARIANCE = 1e-8
"""Of a shape, against that of the first."""


@dataclass(frozen=True)
class Shapes:
    """Offsets are mean (a,) + coefficients (..., r) @ directions (r, a); coefficients are (offsets - mean) @ projection
    (a, r), and their squares add up to the metric's. distance (r, r): see `millimetres`."""

    mean: torch.Tensor
    directions: torch.Tensor
    projection: torch.Tensor
    distance: torch.Tensor

    def coefficients(self, offsets: torch.Tensor) -> torch.Tensor:
        """(..., r) of offsets (..., a)."""
        return (offsets - self.mean) @ self.projection

    def offsets(self, coefficients: torch.Tensor) -> torch.Tensor:
        """(..., a) of coefficients (..., r)."""
        return self.mean + coefficients @ self.directions

    def millimetres(self, differences: torch.Tensor) -> torch.Tensor:
        """Squared distances (...,) [mm2], the mean over cloth by its mass, of differences of coefficients (..., r)."""
        return ((differences @ self.distance) * differences).sum(dim=-1)


def principal_shapes(
    offsets: Iterable[torch.Tensor], inertia: torch.Tensor, cost: torch.Tensor, most: int, mass: float
) -> tuple[Shapes, float, float]:
    """The shapes of offsets that come in parts (N, a), and how far offsets are from their mean, and from what at most
    so many shapes make of them [mm].

    inertia, cost: (a, a), see `WalkerSimulation`. mass [kg] of all cloth. Raises ValueError where nothing differs.
    """
    count, size = 0, len(inertia)
    device = inertia.device
    total = torch.zeros(size, dtype=torch.float64, device=device)
    squares = torch.zeros(size, size, dtype=torch.float64, device=device)
    for part in offsets:
        part = part.double()
        count, total, squares = count + len(part), total + part.sum(dim=0), squares + part.T @ part
    mean = total / max(count, 1)
    covariance = squares / max(count, 1) - torch.outer(mean, mean)
    inertia, cost = inertia.double(), cost.double()
    moved, strained = (inertia * covariance).sum(), (cost * covariance).sum()
    if not (count > 1 and moved > 0):
        raise ValueError(f"nothing is to be learnt of {count} frames in which cloth does not move")
    metric = inertia / moved + COSTLY * cost / strained
    diagonal = metric.diagonal()
    root = torch.linalg.cholesky(metric + torch.diag(1e-6 * diagonal.mean() + 1e-4 * diagonal))
    variances, axes = torch.linalg.eigh(root.T @ covariance @ root)
    variances, axes = variances.flip(0), axes.flip(1)
    rank = min(most, int((variances > LEAST_VARIANCE * variances[0]).sum()))
    axes = axes[:, :rank]
    projection = root @ axes
    directions = torch.linalg.solve_triangular(root, axes.T, upper=False, left=False)
    remaining = torch.eye(size, dtype=torch.float64, device=device) - projection @ directions
    missed = (inertia * (remaining.T @ covariance @ remaining)).sum().clamp_min(0)
    directions, projection = UNIT * directions, projection / UNIT
    distance = 1e6 / mass * directions @ inertia @ directions.T
    shapes = Shapes(*(tensor.float() for tensor in (mean, directions, projection, distance)))
    return shapes, 1e3 * float((moved / mass).sqrt()), 1e3 * float((missed / mass).sqrt())
