"""A step of implicit Euler for many samples at once, in a time that is known before.

A few steps of Newton's method with the second derivative made positive element by element, each solved for by a bounded
number of conjugate gradients. Of the full step, a half and a quarter each sample takes the one of least incremental
potential; a sample is never held up until a crease of the body is resolved, as a minimum at rest has to be: what is
left is seen in the residual, and the next step of time begins from there.

Dimensions: `B` samples, `n` garment vertices. Metres, newtons, joules.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import warp as wp

from physkin_training.dynamics.incremental_potential import IncrementalHessian, IncrementalPotential

__all__ = ["Step", "StepSolver"]

LARGEST_STEP = 0.02
"""No vertex moves farther [m] in one iteration: contact is looked for anew before cloth can pass through a limb."""
SHARES = (1.0, 0.5, 0.25)
FORCING = 0.03
"""Residual of the linear systems, relative to their right-hand sides."""
LOOK_EVERY = 8
"""Products after which it is asked whether all samples are solved."""


@dataclass(frozen=True)
class Step:
    """Where a step ended: vertices (B, n, 3) [m], gradient norm (B,) [N] of the incremental potential there, and Newton
    steps taken by each sample (B,)."""

    vertices: torch.Tensor
    gradient_norm: torch.Tensor
    iterations: torch.Tensor


class StepSolver:
    """Minimises an incremental potential from a good guess. free: (n,) bool, vertices that move."""

    def __init__(self, potential: IncrementalPotential, hessian: IncrementalHessian, free: torch.Tensor) -> None:
        self.potential, self.hessian = potential, hessian
        self._free = free.float()[:, None]

    def minimise(
        self,
        start: torch.Tensor,
        gravity: torch.Tensor,
        body: wp.Mesh,
        body_offset: torch.Tensor,
        *,
        tolerance: float,
        iterations: int,
        products: int,
    ) -> Step:
        """From `start` (B, n, 3) on the posed bodies (see `PhysicsLosses`); tolerance [N] of the gradient norm."""

        def evaluate(vertices: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            gradient = self.potential.evaluate(vertices, gravity, body, body_offset)[1] * self._free
            terms = self.potential.element_energies.values()
            return sum(values.sum(dim=1, dtype=torch.float64) for values in terms), gradient

        here = start.contiguous()
        energy, gradient = evaluate(here)
        norm = _norm(gradient)
        taken = torch.zeros(len(here), dtype=torch.int64, device=here.device)
        exact = torch.zeros(len(here), dtype=torch.bool, device=here.device)
        none = torch.zeros(len(here), device=here.device)
        for iteration in range(iterations):
            active = norm > tolerance
            if not active.any():
                break
            if iteration:  # the line search has evaluated elsewhere
                evaluate(here)
            self.hessian.active.copy_(active)
            self.hessian.assemble(here, body, body_offset, exact)
            self.hessian.add_to_diagonal(torch.zeros_like(self.hessian.diagonal_blocks), none)
            step = _shortened(self._conjugate_gradients(-gradient, products)) * active[:, None, None]
            best, best_energy, best_gradient = here, torch.full_like(energy, torch.inf), gradient
            waiting = active
            for share in SHARES:
                there = here + share * step
                tried, slope = evaluate(there)
                better = waiting & (tried < best_energy)
                best = torch.where(better[:, None, None], there, best)
                best_gradient = torch.where(better[:, None, None], slope, best_gradient)
                best_energy = torch.where(better, tried, best_energy)
                waiting = waiting & (tried > energy)
                if not waiting.any():
                    break
            here, gradient = best, best_gradient
            energy = torch.where(active, best_energy, energy)
            norm = _norm(gradient)
            taken += active
        return Step(here, norm, taken)

    def _conjugate_gradients(self, force: torch.Tensor, products: int) -> torch.Tensor:
        step, product = torch.zeros_like(force), torch.zeros_like(force)
        residual = force * self.hessian.active[:, None, None]
        goal = FORCING * _norm(residual)
        direction = self.hessian.precondition(residual)
        rho = _dot(residual, direction)
        for count in range(1, products + 1):
            self.hessian.multiply(direction, product)
            product *= self._free
            alpha = (rho / _dot(direction, product).clamp_min(1e-20))[:, None, None]
            step += alpha * direction
            residual -= alpha * product
            if count % LOOK_EVERY == 0 and not (_norm(residual) > goal).any():
                break
            ahead = self.hessian.precondition(residual)
            previous, rho = rho, _dot(residual, ahead)
            direction = ahead + (rho / previous.clamp_min(1e-20))[:, None, None] * direction
        return step


def _shortened(step: torch.Tensor) -> torch.Tensor:
    """Steps (B, n, 3) in which no vertex moves farther than `LARGEST_STEP`; others go on as they would."""
    length = torch.linalg.vector_norm(step, dim=2, keepdim=True)
    return step * (LARGEST_STEP / length.clamp_min(LARGEST_STEP))


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a * b).sum(dim=(1, 2))


def _norm(field: torch.Tensor) -> torch.Tensor:
    return torch.linalg.vector_norm(field, dim=(1, 2))
