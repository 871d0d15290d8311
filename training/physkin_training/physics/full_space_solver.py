"""Newton's method for the energy's minimum over all vertices of a garment, several samples at once.

The exact second derivative is used while it curves up along the steps, otherwise one that is made positive block by
block. A step that does not lower the energy is solved for again with what it showed about single vertices
(`vertex_secants`), and finally shortened.

Dimensions: `B` samples, `n` garment vertices. Metres, newtons, joules.
"""

from __future__ import annotations

import torch

from physkin_core.runtime.frame_input import STANDARD_GRAVITY
from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.physics.newton_solver import LARGEST_STEP, NewtonSolver, Point, Solution, inner, norm
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.physics.vertex_secants import Trial, VertexSecants
from physkin_training.quiet_warp import wp

__all__ = ["FullSpaceSolver"]

SUFFICIENT = 1e-4
"""Share of the expected decrease that a step must bring."""
ROUNDING = 3e-9
"""Change of the energy, relative to the sum of its terms' sizes, that single precision cannot tell from none."""
SOLVES = 4
"""Steps that are solved for in one iteration at most. After that the last one is shortened."""
HALVINGS = 10
"""A step shorter than 2^-10 is given up, and the next one damped more."""
GIVE_UP = 6
"""Iterations in a row without any progress after which a sample is left where it is."""
STALL_AFTER = 25
STALL_SHARE = 1e-3
"""A sample is also given up when so many iterations neither halve its gradient norm nor lower its energy by more than
this share of the sum of its terms' sizes."""
FORCING = 0.1
"""Largest residual of the linear systems, relative to their right-hand sides."""
FIRST_DAMPING = 100.0
"""[N/m3], against a cloth of 0.2 kg/m2: its own weight would then move it by 2 cm."""
COOLING, HEATING = 0.5, 4.0
"""Factors of the damping after a full step, and after one that had to be shortened much."""


class FullSpaceSolver(NewtonSolver):
    """Minimises the energy of `losses` over the vertices of their garment.

    The force scale is the garment's weight: at a tolerance of 0.01 the residual forces of all vertices together are a
    hundredth of what the garment weighs. held: (n,) bool, vertices that stay where they are; default none.
    """

    least_curvature = 1e-6

    def __init__(self, losses: PhysicsLosses, *, held: torch.Tensor | None = None) -> None:
        areas, device = losses.cloth.garment.vertex_areas, losses.cloth.device
        self.force_scale = float(areas.sum()) * losses.material.density * STANDARD_GRAVITY
        free = torch.ones(len(areas), device=device)
        super().__init__(EnergyHessian(losses), (free if held is None else free * ~held.to(device))[:, None])

    def minimise(
        self,
        start: torch.Tensor,
        gravity: torch.Tensor,
        body: wp.Mesh,
        body_offset: torch.Tensor,
        *,
        tolerance: float = 1e-2,
        iterations: int = 300,
        products: int = 300,
    ) -> Solution:
        """From `start` (B, n, 3) to the minimum under gravity (B, 3) on the posed bodies (see `PhysicsLosses`).

        tolerance: of the gradient norm, relative to the force scale. iterations: Newton steps at most. products: matrix
        products at most for one step.
        Raises ValueError when the energy at `start` is not finite.
        """
        self.begin(gravity, body, body_offset)
        here = self.point(start.detach().clone())
        if not torch.isfinite(here.energy).all():
            raise ValueError(
                f"the energy at the start is {here.energy.tolist()} J; the start must be finite and regular"
            )
        self._tolerance, self._products = tolerance, products
        self._secants = VertexSecants(here.vertices)
        self._damping = torch.full_like(here.energy, FIRST_DAMPING, dtype=torch.float32)
        self._exact, self._stalled = torch.zeros_like(self._everyone), torch.zeros_like(self._everyone)
        self._failures = torch.zeros_like(self._everyone, dtype=torch.int64)
        self._then = here.energy
        self._lowest, self._lowest_then = (torch.full_like(self._damping, torch.inf) for _ in range(2))
        here, taken = self.descend(here, iterations)
        norms, scale = self._norm(here), self.force_scale
        return Solution(here.vertices, norms <= tolerance * scale, norms, here.terms, taken, scale)

    def under_way(self, here: Point, iteration: int) -> torch.Tensor:
        norms = self._norm(here)
        self._forcing = (norms / self.force_scale).sqrt().clamp(max=FORCING)
        self._lowest = torch.minimum(self._lowest, norms)
        if iteration and iteration % STALL_AFTER == 0:
            level = self._then - here.energy < STALL_SHARE * here.size
            self._stalled |= level & (self._lowest > 0.5 * self._lowest_then)
            self._then, self._lowest_then = here.energy, self._lowest
        return (norms > self._tolerance * self.force_scale) & (self._failures < GIVE_UP) & ~self._stalled

    def assemble(self) -> None:
        self.hessian.assemble(self._exact)
        self.hessian.add_to_diagonal(self._secants.blocks, self._damping)
        self._contacts = [self.losses.collision]
        if self.losses.self_contact.values.numel():
            self._contacts.append(self.losses.self_contact)
        self._contacts_after = [contact.forecast() for contact in self._contacts]

    def search(self, here: Point, active: torch.Tensor) -> Point:
        there, share, bent = self._lower(here, active)
        self.hessian.active.copy_(active)
        self._secants.arrive(active & (share > 0), here.vertices, here.gradient, self._trial(here, there))
        self._failures = torch.where(active & (share == 0), self._failures + 1, 0)
        self._exact = (share >= 1) & ~bent
        factor = torch.where(self._exact, COOLING, torch.where(share < 0.3, HEATING, 1.0))
        self._damping = torch.where(active, self._damping * factor, self._damping).clamp(1e-3, 1e5)
        return there

    def _lower(self, here: Point, active: torch.Tensor) -> tuple[Point, torch.Tensor, torch.Tensor]:
        """A point of less energy; what share of its last step each sample took (B,), 0 if none helped; and which
        samples met negative curvature (B,)."""
        noise = ROUNDING * here.size
        share = active.to(torch.float64)
        waiting = active.clone()
        bent = torch.zeros_like(waiting)
        step = torch.zeros_like(here.vertices)
        for attempt in range(SOLVES + HALVINGS):
            if attempt < SOLVES:
                self.hessian.active.copy_(waiting)
                solved, down = self.solve(-here.gradient, self._products, self._forcing)
                step = torch.where(waiting[:, None, None], _shortened(solved), step)
                bent |= down
                slope = inner(here.gradient, step)
            there = self.point(here.vertices + share.to(step.dtype)[:, None, None] * step)
            change = there.energy - here.energy
            enough = change <= SUFFICIENT * share * slope
            level = (change <= noise) & (inner(there.gradient, step).abs() <= slope.abs())
            waiting &= ~(enough | level)
            if not waiting.any():
                return there, share, bent
            if attempt < SOLVES:
                self.hessian.active.copy_(active)
                added = self._secants.learn(waiting, here.vertices, here.gradient, self._trial(here, there))
                self.hessian.add_to_diagonal(added)
            else:
                best = torch.nan_to_num(-slope * share**2 / (2 * (change - slope * share)), nan=0.0)
                share = torch.where(waiting, best.clamp(0.1 * share, 0.5 * share), share)
        share = torch.where(waiting, 0.0, share)
        return self.point(here.vertices + share.to(step.dtype)[:, None, None] * step), share, bent

    def _trial(self, here: Point, there: Point) -> Trial:
        """The step from here to there, where the losses were evaluated last, and what was foreseen of it."""
        step = there.vertices - here.vertices
        foreseen = torch.zeros_like(step)
        self.hessian.multiply(step, foreseen)
        excess = sum(each.values - after(step) for each, after in zip(self._contacts, self._contacts_after))
        return Trial(there.vertices, there.gradient, foreseen, excess)

    def _norm(self, here: Point) -> torch.Tensor:
        return norm(self._secants.least_gradient(here.vertices, here.gradient))


def _shortened(step: torch.Tensor) -> torch.Tensor:
    """Steps (B, n, 3), scaled so that no vertex moves farther than `LARGEST_STEP`."""
    longest = torch.linalg.vector_norm(step, dim=2).amax(dim=1)
    return step * (LARGEST_STEP / longest.clamp_min(LARGEST_STEP))[:, None, None]
