"""One step of implicit Euler over garment nodes, in bounded time.

The unknowns are changes q (B, m, 3, 4) of garment nodes in their own posed frames; vertices are linear in them. A few
steps of Newton's method are made, each solved by a fixed number of conjugate gradients, and damped as Levenberg and
Marquardt do. Damping and preconditioner use the second derivative at rest, averaged over bodies, which is computed
once. A frame does not wait until every crease is resolved: what is left over is resolved in the next one.

Dimensions: `B` samples, those of a body one after the other, `S` bodies, `m` garment nodes, `n` vertices. Metres,
newtons, joules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch

from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.dynamics.incremental_potential import IncrementalPotential
from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.physics.newton_solver import NewtonSolver, Point, inner, of_samples
from physkin_training.sway.node_skinning import NodeSkinning

__all__ = ["Metric", "NodeStepSolver"]

FIRST_DAMPING = 0.02
"""Share of the metric that is added to the second derivative at first."""
COOLING, HEATING = 0.25, 8.0
"""Change of the damping after a step downhill, and after one that was none."""


@dataclass(frozen=True)
class Metric:
    """What a change of garment nodes costs: a symmetric positive matrix (12 m, 12 m), and its inverse."""

    matrix: torch.Tensor
    inverse: torch.Tensor

    @classmethod
    def regular(cls, matrix: torch.Tensor, free: torch.Tensor) -> Metric:
        """From a matrix that may be singular. free: (m,) bool; the matrix is zero for other garment nodes."""
        held = ~_numbers(free)
        diagonal = matrix.diagonal().clone()
        diagonal[held] = diagonal[~held].mean()
        own = torch.where(held, diagonal, 0.0)
        matrix = matrix + torch.diag(own + 1e-3 * diagonal + 1e-5 * diagonal.max())
        inverse = torch.linalg.inv(matrix.double()).float()
        return cls(matrix, (inverse + inverse.mT) / 2)


class NodeStepSolver(NewtonSolver):
    """Minimises an incremental potential over garment nodes. Gradients and steps are changes of garment nodes in their
    own posed frames. free: (m,) bool, the garment nodes that move.

    Two attributes are to be set before the first step. `metric` is made from `mean_stiffness`. `tether` (12 m,) [J] is
    a weak spring that draws garment nodes back to the drape, because changes that move no cloth would drift on and on.
    It is zero at first, and stays zero for garment nodes that do not move.
    """

    metric: Metric
    asks = False
    hessian_every = 2

    def __init__(
        self, samples: DressedSamples, potential: IncrementalPotential, skinning: NodeSkinning, free: torch.Tensor
    ) -> None:
        potential.band.isotropic = True
        super().__init__(EnergyHessian(potential), free[:, None, None])
        self.tether = torch.zeros(12 * len(free), device=free.device)
        self.samples, self.skinning = samples, skinning

    def minimise(
        self,
        starts: Sequence[torch.Tensor],
        drape: torch.Tensor,
        turns: torch.Tensor,
        gravity: torch.Tensor,
        *,
        newton: int,
        products: int,
        damping: float = FIRST_DAMPING,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Garment nodes (B, m, 3, 4) and vertices (B, n, 3) after a step from the best of `starts`, on the bodies that
        were posed last.

        drape: (B, m, 3, 4), what the tether draws to. turns: (B, m, 3, 3), rotations of the posed garment nodes.
        gravity: (B, 3). newton: how many Newton steps; products: matrix products in each. damping: in the first one.
        """
        self.begin(gravity, *self.samples.contact)
        self._drape, self._turns, self._products = drape, turns, products
        here = self.point(starts[0])
        for start in starts[1:]:
            other = self.point(start)
            here = here.or_where(other.energy < here.energy, other)
        self._damping = torch.full_like(here.energy, damping, dtype=torch.float32)
        here, _ = self.descend(here, newton)
        return here.variables, here.vertices

    def mean_stiffness(self, nodes: torch.Tensor, turns: torch.Tensor, gravity: torch.Tensor) -> torch.Tensor:
        """Second derivative (12 m, 12 m) at garment nodes (B, m, 3, 4), averaged over bodies. The samples of a body
        must be alike."""
        self.begin(gravity, *self.samples.contact)
        self._drape, self._turns = nodes, turns
        self.point(nodes)
        self.assemble()
        return self._mean(self._times)

    def mean_inertia(self, turns: torch.Tensor) -> torch.Tensor:
        """Mass matrix (12 m, 12 m) [kg], averaged over bodies."""
        mass = self.losses.time_step.mass[..., None]

        def times(q: torch.Tensor) -> torch.Tensor:
            return turns.mT @ self.skinning.transposed(mass * self.skinning.vertices(turns @ q))

        return self._mean(times)

    def _mean(self, times: Callable[[torch.Tensor], torch.Tensor]) -> torch.Tensor:
        bodies, numbers = len(self.samples.body_set), _numbers(self.free.flatten())
        samples, size = len(self.samples.body), len(numbers)
        each = samples // bodies
        sample = torch.arange(samples, device=numbers.device)
        matrix = torch.zeros(size, size, device=numbers.device)
        for first in range(0, size, each):  # the samples of a body take the numbers in turn
            unit = torch.zeros(samples, size, device=numbers.device)
            unit[sample, (first + sample % each).clamp_max(size - 1)] = 1
            found = times(unit.view(samples, -1, 3, 4)).flatten(1).unflatten(0, (bodies, each)).mean(dim=0)
            matrix[first : first + each] = found[: size - first]
        matrix = (matrix + matrix.mT) / 2
        return matrix * numbers * numbers[:, None]

    def point(self, variables: torch.Tensor) -> Point:
        here, away = super().point(variables), self._turns.mT @ (variables - self._drape)
        pull = self._drawn_back(away)
        terms = here.terms | {"tether": inner(away, pull) / 2}
        self._last = replace(here, gradient=here.gradient + pull, terms=terms)
        return self._last

    def vertices(self, variables: torch.Tensor) -> torch.Tensor:
        return self.skinning.vertices(variables)

    def pulled_back(self, gradient: torch.Tensor) -> torch.Tensor:
        return self._turns.mT @ self.skinning.transposed(gradient) * self.free

    def step(self, here: Point) -> torch.Tensor:
        return self._turns @ self.solve(-here.gradient, self._products, None)[0]

    def search(self, here: Point, active: torch.Tensor) -> Point:
        there = super().search(here, active)
        self._damping = self._damping * torch.where(there.energy < here.energy, COOLING, HEATING)
        return there

    def multiply(self, direction: torch.Tensor, product: torch.Tensor) -> None:
        damped = of_samples(self._damping, direction) * _through(self.metric.matrix, direction)
        product.copy_(self._times(direction) * self.free + self._drawn_back(direction) + damped)

    def precondition(self, residual: torch.Tensor) -> torch.Tensor:
        return _through(self.metric.inverse, residual)

    def _drawn_back(self, q: torch.Tensor) -> torch.Tensor:
        return (self.tether * q.flatten(1)).view_as(q)

    def _times(self, q: torch.Tensor) -> torch.Tensor:
        """Second derivative times q."""
        with _coarse_products():
            x = self.skinning.vertices(self._turns @ q)
            product = torch.empty_like(x)
            self.hessian.multiply(x, product)
            return self._turns.mT @ self.skinning.transposed(product)


def _through(matrix: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    return (v.flatten(1) @ matrix).view_as(v)


@contextmanager
def _coarse_products() -> Iterator[None]:
    """Matrix products in TF32 on a GPU: directions need no more."""
    matmul = torch.backends.cuda.matmul
    before, matmul.allow_tf32 = matmul.allow_tf32, True
    try:
        yield
    finally:
        matmul.allow_tf32 = before


def _numbers(free: torch.Tensor) -> torch.Tensor:
    """Which of the 12 m numbers are free, of garment nodes (m,)."""
    return free.repeat_interleave(12)
