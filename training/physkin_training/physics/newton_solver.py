"""Newton's method for minima of physics losses, many samples at once: what all our solvers have in common.

Every iteration solves H step = -gradient by conjugate gradients, only as exactly as it deserves (Nocedal and Wright
2006, chapter 7), and goes some share of the step. A solver says what the variables are, when a sample is done, what
preconditions and damps, and how far to go.

Dimensions: `B` samples, `n` garment vertices. Metres, newtons, joules.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch

from physkin_training.energies.energy import view
from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.quiet_warp import wp

__all__ = ["LARGEST_STEP", "NewtonSolver", "Point", "Solution", "inner", "norm", "of_samples"]

LARGEST_STEP = 0.02
"""No vertex moves farther [m] in one iteration: contact is looked for anew before cloth can pass through a limb."""
SYNCHRONISE_EVERY = 8
"""Products after which a GPU is asked whether all samples are solved; a CPU is asked every time."""


@dataclass(frozen=True)
class Point:
    """Variables (B, ...), the vertices (B, n, 3) [m] that they make, the energy's gradient by the variables, energies
    (B,) float64 [J] by term, and what the second derivative needs, `Energy.state`."""

    variables: torch.Tensor
    vertices: torch.Tensor
    gradient: torch.Tensor
    terms: dict[str, torch.Tensor]
    state: list[torch.Tensor]

    @cached_property
    def energy(self) -> torch.Tensor:
        """Sum of the terms (B,); without bound where it is not a number."""
        return sum(self.terms.values()).nan_to_num(nan=torch.inf, posinf=torch.inf)

    @property
    def size(self) -> torch.Tensor:
        """Sum of the terms' sizes (B,)."""
        return sum(values.abs() for values in self.terms.values())

    def or_where(self, chosen: torch.Tensor, other: Point) -> Point:
        """Of the samples that are chosen (B,) bool the other point."""

        def pick(mine: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
            return torch.where(of_samples(chosen, mine), others, mine)

        terms = {name: pick(values, other.terms[name]) for name, values in self.terms.items()}
        mine, others = ((p.variables, p.vertices, p.gradient) for p in (self, other))
        return Point(*map(pick, mine, others), terms, list(map(pick, self.state, other.state)))


@dataclass(frozen=True)
class Solution:
    """Where a solver ended.

    vertices: (B, n, 3) [m]. converged: (B,) bool, whether gradient_norm (B,) [N] is at most what was asked for; the
    norm is over all vertices, see `VertexSecants.least_gradient` for those in creases of the body. energies: (B,)
    float64 [J] by term. iterations: (B,) Newton steps. force_scale [N]: what a tolerance is relative to.
    """

    vertices: torch.Tensor
    converged: torch.Tensor
    gradient_norm: torch.Tensor
    energies: dict[str, torch.Tensor]
    iterations: torch.Tensor
    force_scale: float = 1.0

    @property
    def energy(self) -> torch.Tensor:
        """Sum of the terms (B,) float64 [J]."""
        return sum(self.energies.values())


class NewtonSolver:
    """Minimises the losses of `hessian`. Variables are vertices here, solved for with the inverse diagonal blocks as
    preconditioner. free: of the variables' shape but for B, 1 for those that move and 0 for those that do not.
    """

    shares: tuple[float, ...] = (1.0,)
    """Of a full step that are tried in turn until the energy falls; the one of least energy is taken."""
    may_climb = False
    """Whether that is so if none of them has less energy than where the step begins."""
    hessian_every = 1
    """Iterations that share a second derivative."""
    asks = True
    """Whether the device is asked if any sample is under way; else there are as many iterations as are allowed."""
    least_curvature = 0.0
    """[N/m] along a direction, below which it counts as negative."""

    def __init__(self, hessian: EnergyHessian, free: torch.Tensor) -> None:
        self.losses, self.hessian, self.free = hessian.losses, hessian, free
        self._patience = 1 if free.device.type == "cpu" else SYNCHRONISE_EVERY
        self._everyone = torch.ones_like(hessian.active)

    def descend(self, here: Point, iterations: int) -> tuple[Point, torch.Tensor]:
        """From a point to where all are done, or so many iterations are over; and those of each sample (B,)."""
        taken = torch.zeros_like(self._everyone, dtype=torch.int64)
        for iteration in range(iterations):
            active = self.under_way(here, iteration)
            if self.asks and not active.any():
                break
            if iteration % self.hessian_every == 0:
                if here is not self._last:
                    self._return_to(here)
                self.hessian.active.copy_(active)
                self.assemble()
            here = self.search(here, active)
            taken += active
        return here, taken

    def begin(self, gravity: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor) -> None:
        """Points are under gravity (B, 3) on posed bodies from now on (see `PhysicsLosses`)."""
        self._surroundings = gravity, body, body_offset

    def point(self, variables: torch.Tensor) -> Point:
        """The energy and its gradient there; the losses are evaluated there last."""
        vertices = self.vertices(variables)
        _, gradient = self.losses.evaluate(vertices, *self._surroundings)
        terms = {energy.name: energy.values.sum(dim=1, dtype=torch.float64) for energy in self.losses.energies}
        state = [tensor.clone() for energy in self.losses.energies for tensor in energy.state]
        self._last = Point(variables, vertices, self.pulled_back(gradient), terms, state)
        return self._last

    def _return_to(self, here: Point) -> None:
        """As if the losses had been evaluated there last, for the second derivative."""
        for mine, kept in zip((tensor for energy in self.losses.energies for tensor in energy.state), here.state):
            mine.copy_(kept)
        self.losses.drapes.x = view(here.vertices)

    def vertices(self, variables: torch.Tensor) -> torch.Tensor:
        """(B, n, 3)."""
        return variables.contiguous()

    def pulled_back(self, gradient: torch.Tensor) -> torch.Tensor:
        """From a gradient by vertices (B, n, 3) to that by variables."""
        return gradient * self.free

    def under_way(self, here: Point, iteration: int) -> torch.Tensor:
        """Samples (B,) bool that are not done."""
        return self._everyone

    def assemble(self) -> None:
        """Compute the second derivative of the active samples where the losses were evaluated last."""
        self.hessian.assemble(torch.zeros_like(self._everyone))
        self.hessian.add_to_diagonal()

    def multiply(self, direction: torch.Tensor, product: torch.Tensor) -> None:
        """Write the second derivative times a direction, both in variables, into `product`."""
        self.hessian.multiply(direction, product)
        product *= self.free

    def precondition(self, residual: torch.Tensor) -> torch.Tensor:
        """A cheap inverse of it times a residual."""
        return self.hessian.precondition(residual)

    def step(self, here: Point) -> torch.Tensor:
        """The full step from a point."""
        raise NotImplementedError

    def search(self, here: Point, active: torch.Tensor) -> Point:
        """Where the active samples (B,) go."""
        step = self.step(here)
        best, energy = here, torch.full_like(here.energy, torch.inf) if self.may_climb else here.energy
        waiting = active
        for share in self.shares:
            if share < 1 and not waiting.any():
                break
            there = self.point(here.variables + share * step)
            better = waiting & (there.energy < energy)
            best, energy = best.or_where(better, there), torch.where(better, there.energy, energy)
            waiting = waiting & (there.energy > here.energy)
        return best

    def solve(
        self, force: torch.Tensor, products: int, forcing: torch.Tensor | float | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Steps, in variables, of the samples that the Hessian has active, and which of them met negative curvature
        (B,); those stop where they are (Steihaug 1983). products: matrix products at most. forcing: the share of the
        residual's norm that may be left; None uses all products."""
        waiting = self.hessian.active.clone()
        step, product = torch.zeros_like(force), torch.zeros_like(force)
        residual = force * of_samples(waiting, force)
        goal = None if forcing is None else forcing * norm(residual)
        direction = self.precondition(residual)
        rho = inner(residual, direction)
        bent = torch.zeros_like(waiting)
        for count in range(1, products + 1):
            self.multiply(direction, product)
            curvature = inner(direction, product)
            down = waiting & (curvature <= self.least_curvature * inner(direction, direction))
            bent |= down
            waiting = waiting & ~down
            alpha = torch.where(waiting, rho / curvature, 0.0)
            if count == 1:  # nothing found yet: along the preconditioned gradient
                alpha = torch.where(down, 1.0, alpha)
            alpha = of_samples(alpha.to(step.dtype), step)
            step += alpha * direction
            residual -= alpha * product
            if goal is not None:
                waiting &= norm(residual) > goal
                if count % self._patience == 0 and not waiting.any():
                    break
            ahead = self.precondition(residual)
            previous, rho = rho, inner(residual, ahead)
            beta = torch.where(waiting, rho / previous, 0.0).to(step.dtype)
            direction = ahead + of_samples(beta, step) * direction
        return step, bent


def of_samples(values: torch.Tensor, field: torch.Tensor) -> torch.Tensor:
    """Values (B,) in a shape that multiplies a field (B, ...)."""
    return values.view(-1, *[1] * (field.dim() - 1))


def inner(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Inner product (B,) float64 of two fields (B, ...)."""
    return (a * b).flatten(1).sum(dim=1, dtype=torch.float64)


def norm(field: torch.Tensor) -> torch.Tensor:
    """Norm (B,) of a field (B, ...)."""
    return torch.linalg.vector_norm(field.flatten(1), dim=1)
