"""Newton's method for the energy's minimum over all vertices of a garment, several samples at once.

Every iteration solves H step = -gradient by conjugate gradients, only as exactly as the distance from the minimum
deserves (Nocedal and Wright 2006, chapter 7). H is the exact second derivative while that curves up along the steps,
and the one made positive block by block where it did not. A step that does not decrease the energy is solved for anew
with what it taught about single vertices (`vertex_secants`), and at last shortened.

Dimensions: `B` samples, `n` garment vertices. Metres, newtons, joules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
import warp as wp

from physkin_core.model.garment import Garment
from physkin_core.sway.frame_input import STANDARD_GRAVITY
from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.physics.vertex_secants import Trial, VertexSecants

__all__ = ["FullSpaceSolver", "Progress", "Solution"]

LARGEST_STEP = 0.02
"""No vertex moves farther [m] in one iteration: contact is looked for anew before cloth can pass through a limb."""
SUFFICIENT = 1e-4
"""Share of the decrease expected along a step that it must bring."""
ROUNDING = 3e-9
"""Change of the energy, relative to the sum of its terms' sizes, that single precision cannot tell from none."""
SOLVES = 4
"""Steps solved for in one iteration at most; after that the last one is shortened."""
HALVINGS = 10
"""A step shorter than 2^-10 is given up, and the next one damped more."""
GIVE_UP = 6
"""Iterations in a row without any progress after which a sample is left where it is."""
STALL_AFTER = 25
STALL_SHARE = 1e-3
"""A sample is given up, too, when so many iterations neither halve its gradient norm nor bring its energy down by more
than this share of the sum of its terms' sizes."""
FORCING = 0.1
"""Largest residual of the linear systems, relative to their right-hand sides."""
FIRST_DAMPING = 100.0
"""[N/m3], against a cloth of 0.2 kg/m2: its own weight would then move it by 2 cm."""
COOLING, HEATING = 0.5, 4.0
"""Change of the damping after a full step, and after one that had to be shortened much."""
SYNCHRONISE_EVERY = 8
"""Products after which a GPU is asked whether all samples are solved; a CPU is asked every time."""


@dataclass(frozen=True)
class Solution:
    """Where the solver ended.

    vertices: (B, n, 3) [m]. converged: (B,) bool, whether gradient_norm (B,) [N] is at most the tolerance times
    force_scale [N]; the norm is over all vertices, see `VertexSecants.least_gradient` for those in creases of the body.
    energies: (B,) float64 [J] by term. iterations: (B,) Newton steps.
    """

    vertices: torch.Tensor
    converged: torch.Tensor
    gradient_norm: torch.Tensor
    force_scale: float
    energies: dict[str, torch.Tensor]
    iterations: torch.Tensor

    @property
    def energy(self) -> torch.Tensor:
        """Sum of the terms (B,) float64 [J]."""
        return sum(self.energies.values())


@dataclass(frozen=True)
class Progress:
    """State after an iteration: energy (B,) float64 [J], gradient norm (B,) [N], matrix products so far, and which
    samples were still under way (B,) bool."""

    iteration: int
    energy: torch.Tensor
    gradient_norm: torch.Tensor
    products: int
    active: torch.Tensor


@dataclass(frozen=True)
class _Point:
    vertices: torch.Tensor
    gradient: torch.Tensor
    terms: dict[str, torch.Tensor]
    contact: torch.Tensor  # (B, n) [J]

    @property
    def energy(self) -> torch.Tensor:
        return sum(self.terms.values())

    @property
    def size(self) -> torch.Tensor:
        return sum(values.abs() for values in self.terms.values())


class FullSpaceSolver:
    """Minimises the energy of `losses` over the vertices of their garment.

    The force scale is the garment's weight: at a tolerance of 0.01 the residual forces of all vertices together are a
    hundredth of what the garment weighs. held: (n,) bool, vertices that stay where they are; default none. hessian: of
    losses that have terms of their own.
    """

    def __init__(
        self,
        garment: Garment,
        losses: PhysicsLosses,
        samples: int,
        device: torch.device,
        *,
        held: torch.Tensor | None = None,
        hessian: EnergyHessian | None = None,
    ) -> None:
        self.losses = losses
        self.force_scale = float(garment.vertex_areas.sum()) * losses.material.density * STANDARD_GRAVITY
        self._hessian = hessian or EnergyHessian(garment, losses, samples, device)
        free = torch.ones(len(garment.vertices), device=device)
        self._free = (free if held is None else free * ~held.to(device))[:, None]
        self._patience = 1 if device.type == "cpu" else SYNCHRONISE_EVERY

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
        watch: Callable[[Progress], None] | None = None,
    ) -> Solution:
        """From `start` (B, n, 3) to the minimum under gravity (B, 3) on the posed bodies (see `PhysicsLosses`).

        tolerance: of the gradient norm, relative to the force scale. iterations: Newton steps at most. products: matrix
        products at most for one step. watch: called after every iteration.
        Raises ValueError when the energy at `start` is not finite.
        """

        def evaluate(vertices: torch.Tensor) -> _Point:
            gradient = self.losses.evaluate(vertices, gravity, body, body_offset)[1] * self._free
            elements = self.losses.element_energies
            terms = {name: values.sum(dim=1, dtype=torch.float64) for name, values in elements.items()}
            return _Point(vertices, gradient, terms, elements["collision"].clone())

        here = evaluate(start.detach().clone().contiguous())
        if not torch.isfinite(here.energy).all():
            raise ValueError(
                f"the energy at the start is {here.energy.tolist()} J; the start must be finite and regular"
            )
        secants = VertexSecants(here.vertices)
        damping = torch.full_like(here.energy, FIRST_DAMPING, dtype=torch.float32)
        exact = torch.zeros_like(here.energy, dtype=torch.bool)
        taken, failures, used = (torch.zeros_like(exact, dtype=torch.int64) for _ in range(3))
        stalled = torch.zeros_like(exact)
        then, lowest, norm_then = here.energy, torch.full_like(damping, torch.inf), torch.full_like(damping, torch.inf)
        for iteration in range(iterations):
            norm = _norm(secants.least_gradient(here.vertices, here.gradient))
            lowest = torch.minimum(lowest, norm)
            if iteration and iteration % STALL_AFTER == 0:
                stalled |= (then - here.energy < STALL_SHARE * here.size) & (lowest > 0.5 * norm_then)
                then, norm_then = here.energy, lowest
            active = (norm > tolerance * self.force_scale) & (failures < GIVE_UP) & ~stalled
            if not active.any():
                break
            self._hessian.active.copy_(active)
            self._hessian.assemble(here.vertices, body, body_offset, exact)
            self._hessian.add_to_diagonal(secants.blocks, damping)
            forcing = (norm / self.force_scale).sqrt().clamp(max=FORCING)
            there, share, bent, count = self._step(evaluate, here, secants, active, forcing, products)
            self._hessian.active.copy_(active)
            secants.arrive(active & (share > 0), here.vertices, here.gradient, self._trial(here, there))
            here = there
            taken += active
            used += count
            failures = torch.where(active & (share == 0), failures + 1, 0)
            exact = (share >= 1) & ~bent
            factor = torch.where(exact, COOLING, torch.where(share < 0.3, HEATING, 1.0))
            damping = torch.where(active, damping * factor, damping).clamp(1e-3, 1e5)
            if watch:
                norm = _norm(secants.least_gradient(here.vertices, here.gradient))
                watch(Progress(iteration, here.energy, norm, int(used.max()), active))
        norm = _norm(secants.least_gradient(here.vertices, here.gradient))
        converged = norm <= tolerance * self.force_scale
        return Solution(here.vertices, converged, norm, self.force_scale, here.terms, taken)

    def _step(
        self,
        evaluate: Callable[[torch.Tensor], _Point],
        here: _Point,
        secants: VertexSecants,
        active: torch.Tensor,
        forcing: torch.Tensor,
        products: int,
    ) -> tuple[_Point, torch.Tensor, torch.Tensor, int]:
        """A point of less energy; what share of its last step each sample took (B,), 0 if none helped; which samples
        met negative curvature (B,); and the matrix products used."""
        noise = ROUNDING * here.size
        share = active.to(torch.float64)
        waiting = active.clone()
        bent = torch.zeros_like(waiting)
        step = torch.zeros_like(here.vertices)
        used = 0
        for attempt in range(SOLVES + HALVINGS):
            if attempt < SOLVES:
                self._hessian.active.copy_(waiting)
                solved, down, count = self._conjugate_gradients(-here.gradient, forcing, products)
                step = torch.where(waiting[:, None, None], _shortened(solved), step)
                bent |= down
                used += count
                slope = _dot(here.gradient, step)
            there = evaluate(here.vertices + share.to(step.dtype)[:, None, None] * step)
            change = there.energy - here.energy
            enough = change <= SUFFICIENT * share * slope
            level = (change <= noise) & (_dot(there.gradient, step).abs() <= slope.abs())
            waiting &= ~(enough | level)
            if not waiting.any():
                return there, share, bent, used
            if attempt < SOLVES:
                self._hessian.active.copy_(active)
                added = secants.learn(waiting, here.vertices, here.gradient, self._trial(here, there))
                self._hessian.add_to_diagonal(added, torch.zeros_like(forcing))
            else:
                best = torch.nan_to_num(-slope * share**2 / (2 * (change - slope * share)), nan=0.0)
                share = torch.where(waiting, best.clamp(0.1 * share, 0.5 * share), share)
        share = torch.where(waiting, 0.0, share)
        there = evaluate(here.vertices + share.to(step.dtype)[:, None, None] * step)
        return there, share, bent, used

    def _trial(self, here: _Point, there: _Point) -> Trial:
        """What was foreseen of the way from here to there, by the second derivative at hand."""
        step = there.vertices - here.vertices
        foreseen = torch.zeros_like(step)
        self._hessian.multiply(step, foreseen)
        along = (self._hessian.contact_gradient * step).sum(dim=2)
        # k depth^2 with the depth changed along the normal: k depth^2 is the energy, -2 k depth normal the gradient.
        squared = torch.where(here.contact > 0, along**2 / (4 * here.contact.clamp_min(1e-20)), 0.0)
        return Trial(there.vertices, there.gradient, foreseen, there.contact - here.contact - along - squared)

    def _conjugate_gradients(
        self, force: torch.Tensor, forcing: torch.Tensor, products: int
    ) -> tuple[torch.Tensor, torch.Tensor, int]:
        """Steps (B, n, 3), which samples met negative curvature (B,), and how many products were needed.

        A sample that meets negative curvature stops where it is (Steihaug 1983).
        """
        step, product = torch.zeros_like(force), torch.zeros_like(force)
        residual = force * self._hessian.active[:, None, None]
        goal = forcing * _norm(residual)
        ahead = self._hessian.precondition(residual)
        direction = ahead.clone()
        rho = _dot(residual, ahead)
        waiting = self._hessian.active.clone()
        bent = torch.zeros_like(waiting)
        for count in range(1, products + 1):
            self._hessian.multiply(direction, product)
            product *= self._free
            curvature = _dot(direction, product)
            down = waiting & (curvature <= 1e-6 * _dot(direction, direction))
            bent |= down
            waiting = waiting & ~down
            alpha = torch.where(waiting, rho / curvature, 0.0)
            if count == 1:  # nothing found yet: along the preconditioned gradient
                alpha = torch.where(down, 1.0, alpha)
            alpha = alpha.to(step.dtype)[:, None, None]
            step += alpha * direction
            residual -= alpha * product
            waiting &= _norm(residual) > goal
            if count % self._patience == 0 and not waiting.any():
                break
            ahead = self._hessian.precondition(residual)
            previous, rho = rho, _dot(residual, ahead)
            beta = torch.where(waiting, rho / previous, 0.0).to(step.dtype)[:, None, None]
            direction = ahead + beta * direction
        return step, bent, count


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
