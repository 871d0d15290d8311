"""A step of implicit Euler for many samples at once, in bounded time.

A few steps of Newton's method with the second derivative made positive element by element, each solved for by a bounded
number of conjugate gradients. Of the full step, a half and a quarter each sample takes the one of least incremental
potential; a sample is never held up until a crease of the body is resolved, as a minimum at rest has to be: what is
left is seen in the residual, and the next step of time begins from there.

Dimensions: `B` samples, `n` garment vertices. Metres, newtons, joules.
"""

from __future__ import annotations

import torch

from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.physics.newton_solver import LARGEST_STEP, NewtonSolver, Point, Solution, norm
from physkin_training.quiet_warp import wp

__all__ = ["StepSolver"]

FORCING = 0.03
"""Residual of the linear systems, relative to their right-hand sides."""


class StepSolver(NewtonSolver):
    """Minimises the incremental potential of `hessian` from a good guess. free: (n,) bool, vertices that move."""

    shares = (1.0, 0.5, 0.25)
    may_climb = True

    def __init__(self, hessian: EnergyHessian, free: torch.Tensor) -> None:
        super().__init__(hessian, free.float()[:, None])

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
    ) -> Solution:
        """From `start` (B, n, 3) on the posed bodies (see `PhysicsLosses`); tolerance [N] of the gradient norm."""
        self.begin(gravity, body, body_offset)
        self._tolerance, self._products = tolerance, products
        here, taken = self.descend(self.point(start), iterations)
        norms = norm(here.gradient)
        return Solution(here.vertices, norms <= tolerance, norms, here.terms, taken)

    def under_way(self, here: Point, iteration: int) -> torch.Tensor:
        return norm(here.gradient) > self._tolerance

    def step(self, here: Point) -> torch.Tensor:
        """No vertex moves farther than `LARGEST_STEP`; others go on as they would."""
        step, _ = self.solve(-here.gradient, self._products, FORCING)
        length = torch.linalg.vector_norm(step, dim=2, keepdim=True)
        return step * (LARGEST_STEP / length.clamp_min(LARGEST_STEP))
