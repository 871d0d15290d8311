"""What trial steps show about single vertices: contact that a second derivative at one point cannot foresee.

Where a vertex meets the body, or crosses from one side of a crease of the body to the other, its force jumps. That must
not keep the whole garment from moving. A vertex whose force at a trial point differs from what was foreseen gets the
stiffness that would have foreseen it, for the next tries: a secant, of rank one and for that vertex alone.

Dimensions: `B` samples, `n` garment vertices. Metres, newtons, joules.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

__all__ = ["Trial", "VertexSecants"]

SURPRISE = 0.1
"""An outcome is learned from if it differs from the work foreseen at a vertex by this share or more."""
DECAY = 0.5
"""Share of a secant that remains after every iteration."""
CREASE = 1e-4
"""Two forces on a vertex count as those of one crease when found no farther [m] apart."""
WALL = 1e3
"""[N] force on the far side of a step at which the contact energy jumps up; above any force of cloth."""
TINY = 1e-12


@dataclass(frozen=True)
class Trial:
    """One step that was tried, (B, n, 3): where it led [m], the gradient there [N], and the change of the gradient that
    was foreseen; and contact energy (B, n) [J] beyond what was foreseen."""

    vertices: torch.Tensor
    gradient: torch.Tensor
    foreseen: torch.Tensor
    excess: torch.Tensor


class VertexSecants:
    """Additional stiffness of single vertices, `blocks` (B, n, 3, 3) [N/m], and the creases they were found in."""

    def __init__(self, vertices: torch.Tensor) -> None:
        self.blocks = torch.zeros(*vertices.shape, 3, device=vertices.device)
        self._jump = torch.zeros_like(vertices)
        self._place = torch.full_like(vertices, torch.inf)

    def learn(
        self, samples: torch.Tensor, vertices: torch.Tensor, gradient: torch.Tensor, trial: Trial
    ) -> torch.Tensor:
        """Learn from a step that samples (B,) bool cannot take; returns the blocks that this adds."""
        step = trial.vertices - vertices
        turned, climbed = self._surprised(samples, step, gradient, trial)
        surprise = trial.gradient - gradient - trial.foreseen
        along = (surprise * step).sum(dim=2)
        squared = (step * step).sum(dim=2).clamp_min(TINY)
        factor = torch.where(turned, 1 / along.clamp_min(TINY), 0.0)
        factor = torch.where(climbed, 2 * trial.excess / squared**2, factor)
        direction = torch.where(climbed[:, :, None], step, surprise)
        added = factor[:, :, None, None] * direction[:, :, :, None] * direction[:, :, None, :]
        self.blocks += added
        self._note(turned, climbed, trial.vertices, trial.gradient - gradient, step)
        return added

    def arrive(self, samples: torch.Tensor, vertices: torch.Tensor, gradient: torch.Tensor, trial: Trial) -> None:
        """Samples (B,) bool have taken the step: the surprise about it is now on their other side."""
        self.blocks *= DECAY
        turned, climbed = self._surprised(samples, trial.vertices - vertices, gradient, trial)
        none = torch.zeros_like(climbed)
        self._note(turned, none, vertices, gradient - trial.gradient, vertices - trial.vertices)

    def least_gradient(self, vertices: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
        """The gradient (B, n, 3), but for vertices in a crease the smallest mean of the gradients on its two sides.

        At a minimum the force on such a vertex does not vanish on either side; a weighted mean of the two does
        (Goldstein 1977).
        """
        near = torch.linalg.vector_norm(vertices - self._place, dim=2) < CREASE
        squared = (self._jump * self._jump).sum(dim=2).clamp_min(1e-20)
        share = (-(gradient * self._jump).sum(dim=2) / squared).clamp(0, 1)
        return gradient + torch.where(near, share, 0.0)[:, :, None] * self._jump

    def _surprised(
        self, samples: torch.Tensor, step: torch.Tensor, gradient: torch.Tensor, trial: Trial
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Vertices (B, n) whose force turned against the step, and those whose contact energy jumped up instead."""
        least = (SURPRISE * (gradient * step).sum(dim=2).abs()).clamp_min(TINY)
        along = ((trial.gradient - gradient - trial.foreseen) * step).sum(dim=2)
        turned = samples[:, None] & (along > least)
        return turned, samples[:, None] & ~turned & (2 * trial.excess > least)

    def _note(self, turned, climbed, place, jump, step) -> None:
        """Remember where the other force was found, and its difference from the one here."""
        length = torch.linalg.vector_norm(step, dim=2, keepdim=True).clamp_min(1e-6)
        jump = torch.where(climbed[:, :, None], step * (WALL / length), jump)
        changed = (turned | climbed)[:, :, None]
        self._jump = torch.where(changed, jump, self._jump)
        self._place = torch.where(changed, place, self._place)
