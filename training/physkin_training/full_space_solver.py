"""Newton's method for the energy's minimum over all vertices of a garment, several samples at once.

Every iteration solves H step = -gradient by conjugate gradients, only as exactly as the distance from the minimum
deserves, and goes along the step as far as the energy falls (Nocedal and Wright 2006, chapters 3, 6 and 7). H is the
exact second derivative where that serves: where it curves down, the block-wise positive one takes its place.

Dimensions: `B` samples, `n` garment vertices. Metres, newtons, joules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
import warp as wp

from physkin_core.garment import Garment
from physkin_training.energy_hessian import EnergyHessian
from physkin_training.physics_losses import GRAVITY, PhysicsLosses

__all__ = ["FullSpaceSolver", "Solution"]

LARGEST_STEP = 0.02
"""No vertex moves farther [m] in one iteration: contact is looked for anew before cloth can pass through a limb."""
SUFFICIENT = 1e-4
"""Share of the decrease expected along a step that it must bring."""
ROUNDING = 3e-9
"""Change of the energy, relative to the sum of its terms' sizes, that single precision cannot tell from none."""
HALVINGS = 10
"""A step shorter than 2^-10 is given up, and the next one damped more."""
RETRIES = 4
CREASE = 1e-4
GIVE_UP = 6
"""Iterations in a row without any progress after which a sample is left where it is."""
FIRST_DAMPING = 100.0
"""[N/m3], against a cloth of 0.2 kg/m2: its own weight would then move it by 2 cm."""


@dataclass(frozen=True)
class Solution:
    """Where the solver ended.

    vertices: (B, n, 3) [m]. converged: (B,) bool, whether gradient_norm (B,) [N], the norm over all vertices, is at most
    `tolerance` times force_scale [N]. energies: (B,) float64 [J] by term. iterations: (B,) Newton steps, and
    products: matrix products of all of them together.
    """

    vertices: torch.Tensor
    converged: torch.Tensor
    gradient_norm: torch.Tensor
    force_scale: float
    energies: dict[str, torch.Tensor]
    iterations: torch.Tensor
    products: int

    @property
    def energy(self) -> torch.Tensor:
        """Sum of the terms (B,) float64 [J]."""
        return sum(self.energies.values())


@dataclass(frozen=True)
class Progress:
    """State after an iteration: energy (B,) float64 [J], gradient norm (B,) [N], length (B,) of the step taken as a
    share of Newton's, and which samples are still under way (B,) bool."""

    iteration: int
    energy: torch.Tensor
    gradient_norm: torch.Tensor
    share: torch.Tensor
    active: torch.Tensor
    attempt: int=0


class Kinks:
    def __init__(self, x):
        self.blocks = torch.zeros(*x.shape, 3, device=x.device)
        self.jump = torch.zeros_like(x)
        self.place = torch.full_like(x, 1e3)

    def learn(self, open_, x, step, gradient, new_gradient, product):
        surprise = new_gradient - gradient - product
        along = (surprise * step).sum(dim=2)
        chosen = open_[:, None] & (along > 0.1 * (gradient * step).sum(dim=2).abs()) & (along > 1e-12)
        factor = torch.where(chosen, 1 / along.clamp_min(1e-12), 0.0)
        added = factor[:, :, None, None] * surprise[:, :, :, None] * surprise[:, :, None, :]
        self.blocks += added
        self.jump = torch.where(chosen[:, :, None], new_gradient - gradient, self.jump)
        self.place = torch.where(chosen[:, :, None], x + step, self.place)
        return added

    def least(self, x, gradient):
        near = torch.linalg.vector_norm(x - self.place, dim=2) < CREASE
        size = (self.jump * self.jump).sum(dim=2).clamp_min(1e-20)
        share = (-(gradient * self.jump).sum(dim=2) / size).clamp(0, 1)
        return gradient + torch.where(near, share, 0.0)[:, :, None] * self.jump


class FullSpaceSolver:
    """Minimises the energy of `losses` over the vertices of their garment.

    The force scale is the garment's weight: at a tolerance of 1e-3 the norm of all vertices' residual forces is a
    thousandth of what the garment weighs.
    """

    def __init__(self, garment: Garment, losses: PhysicsLosses, samples: int, device: torch.device) -> None:
        self.losses = losses
        self.force_scale = float(garment.vertex_areas.sum()) * losses.material.density * GRAVITY
        self.hessian = EnergyHessian(garment, losses, samples, device)

    def minimise(
        self,
        start: torch.Tensor,
        gravity: torch.Tensor,
        body: wp.Mesh,
        body_offset: torch.Tensor,
        *,
        tolerance: float = 1e-3,
        iterations: int = 200,
        products: int = 300,
        watch: Callable[[Progress], None] | None = None,
    ) -> Solution:
        """From `start` (B, n, 3) to the minimum under gravity (B, 3) on the posed bodies (see `PhysicsLosses`).

        tolerance: of the gradient norm, relative to the force scale. iterations: Newton steps at most. products: matrix
        products at most in one of them. watch: called after every iteration.
        Raises ValueError when the energy at `start` is not finite.
        """
        x = start.detach().clone().contiguous()
        samples, device = len(x), x.device

        def evaluate(points: torch.Tensor) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
            gradient = self.losses.evaluate(points, gravity, body, body_offset)[1]
            elements = self.losses.element_energies
            return {name: values.sum(dim=1, dtype=torch.float64) for name, values in elements.items()}, gradient

        terms, gradient = evaluate(x)
        if not torch.isfinite(sum(terms.values())).all():
            raise ValueError("the energy at the start is not finite")
        damping = torch.full((samples,), FIRST_DAMPING, device=device)
        exact = torch.zeros(samples, dtype=torch.bool, device=device)
        taken = torch.zeros(samples, dtype=torch.int64, device=device)
        failures = torch.zeros(samples, dtype=torch.int64, device=device)
        kinks = Kinks(x)
        used = 0
        for iteration in range(iterations):
            norm = _norm(kinks.least(x, gradient))
            active = (norm > tolerance * self.force_scale) & (failures < GIVE_UP)
            if not active.any():
                break
            self.hessian.active.copy_(active)
            self.hessian.assemble(x, body, body_offset, exact)
            self.hessian.add_to_diagonal(kinks.blocks, damping)
            forcing = (norm / self.force_scale).sqrt().clamp(max=0.1)
            energy = sum(terms.values())
            noise = ROUNDING * sum(values.abs() for values in terms.values())
            share = active.to(torch.float64)
            open_ = active.clone()
            negative = torch.zeros_like(open_)
            step = torch.zeros_like(x)
            for attempt in range(RETRIES + HALVINGS):
                if attempt < RETRIES:
                    self.hessian.active.copy_(open_)
                    again, down, count = self._conjugate_gradients(-gradient, forcing, products)
                    step = torch.where(open_[:, None, None], _shortened(again), step)
                    negative |= down & open_
                    used += count
                    slope = _dot(gradient, step)
                there = x + share.to(x.dtype)[:, None, None] * step
                new_terms, new_gradient = evaluate(there)
                change = sum(new_terms.values()) - energy
                enough = change <= SUFFICIENT * share * slope
                level = (change <= noise) & (_dot(new_gradient, step).abs() <= slope.abs())
                open_ &= ~(enough | level)
                if not open_.any():
                    break
                if attempt < RETRIES:
                    added = kinks.learn(open_, x, step, gradient, new_gradient, self._product(step))
                    self.hessian.add_to_diagonal(added, torch.zeros_like(damping))
                else:
                    best = -slope * share**2 / (2 * (change - slope * share))
                    best = torch.nan_to_num(best, nan=0.0).clamp(0.1 * share, 0.5 * share)
                    share = torch.where(open_, best, share)
            if open_.any():
                share = torch.where(open_, 0.0, share)
                there = x + share.to(x.dtype)[:, None, None] * step
                new_terms, new_gradient = evaluate(there)
            x, terms, gradient = there, new_terms, new_gradient
            taken += active
            kinks.blocks *= 0.5
            full, failed = share >= 1, active & (share == 0)
            failures = torch.where(failed, failures + 1, 0)
            exact = full & ~negative
            factor = torch.where(full & ~negative, 0.2, torch.where(share < 0.3, 4.0, 1.0))
            damping = torch.where(active, damping * factor, damping).clamp(1e-3, 1e5)
            if watch:
                watch(Progress(iteration, sum(terms.values()), _norm(kinks.least(x, gradient)), share, active, attempt))
        norm = _norm(kinks.least(x, gradient))
        return Solution(x, norm <= tolerance * self.force_scale, norm, self.force_scale, terms, taken, used)

    def _product(self, step):
        product = torch.zeros_like(step)
        self.hessian.multiply(step, product)
        return product

    def _conjugate_gradients(
        self, force: torch.Tensor, forcing: torch.Tensor, products: int
    ) -> tuple[torch.Tensor, torch.Tensor, int]:
        """Steps (B, n, 3), which samples met negative curvature (B,), and how many products were needed."""
        step = torch.zeros_like(force)
        residual = force * self.hessian.active[:, None, None]
        goal = forcing * _norm(residual)
        ahead = self.hessian.precondition(residual)
        direction = ahead.clone()
        product = torch.zeros_like(force)
        rho = _dot(residual, ahead)
        open_ = self.hessian.active.clone()
        negative = torch.zeros_like(open_)
        for count in range(1, products + 1):
            self.hessian.multiply(direction, product)
            curvature = _dot(direction, product)
            size = _dot(direction, direction)
            down = open_ & (curvature <= 1e-6 * size)
            negative |= down
            open_ = open_ & ~down
            alpha = torch.where(open_, rho / curvature, 0.0)
            if count == 1:  # nothing found yet: go along the gradient, as far as the longest step allows
                alpha = torch.where(down, 1.0, alpha)
            alpha = alpha.to(step.dtype)[:, None, None]
            step += alpha * direction
            residual -= alpha * product
            open_ &= _norm(residual) > goal
            if not open_.any():
                break
            ahead = self.hessian.precondition(residual)
            previous, rho = rho, _dot(residual, ahead)
            beta = torch.where(open_, rho / previous, 0.0).to(step.dtype)[:, None, None]
            direction = ahead + beta * direction
        return step, negative, count


def _shortened(step: torch.Tensor) -> torch.Tensor:
    """Steps (B, n, 3), scaled so that no vertex moves farther than `LARGEST_STEP`."""
    longest = torch.linalg.vector_norm(step, dim=2).amax(dim=1)
    return step * (LARGEST_STEP / longest.clamp_min(LARGEST_STEP))[:, None, None]


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Inner product (B,) float64 of two fields (B, n, 3)."""
    return (a * b).sum(dim=(1, 2), dtype=torch.float64)


def _norm(field: torch.Tensor) -> torch.Tensor:
    """Norm (B,) of a field (B, n, 3)."""
    return torch.linalg.vector_norm(field, dim=(1, 2))
