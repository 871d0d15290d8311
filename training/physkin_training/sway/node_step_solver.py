"""A step of implicit Euler in the numbers of garment nodes, in a time that is known before.

Free are changes q (B, m, 3, 4) of garment nodes, in their own posed frames; vertices are linear in them. A few steps of
Newton's method, each by a fixed number of conjugate gradients, damped as Levenberg and Marquardt do. What damps, and
what preconditions, is the mean over bodies at rest of the second derivative, which is learnt once. Cloth is not held up
until every crease is resolved: what is left is taken up in the next frame.

Dimensions: `B` samples, those of a body one after the other, `S` bodies, `m` garment nodes, `n` vertices. Metres,
newtons, joules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields

import torch

from physkin_training.dynamics.dressed_samples import DressedSamples
from physkin_training.dynamics.incremental_potential import IncrementalHessian, IncrementalPotential
from physkin_training.physics.energy_kernels import BAND_STIFFNESS
from physkin_training.sway.node_skinning import NodeSkinning

__all__ = ["Metric", "NodeStepSolver"]

HESSIAN_EVERY = 2
"""Newton steps that share a second derivative."""
FIRST_DAMPING = 0.02
"""Share of the metric that is added to the second derivative at first."""
COOLING, HEATING = 0.25, 8.0
"""Change of the damping after a step downhill, and after one that was none."""
NOT_FINITE = 1e9
"""[J] what an energy counts that is not a number."""


@dataclass(frozen=True)
class Metric:
    """What a change of garment nodes costs: a symmetric positive matrix (12 m, 12 m), and its inverse."""

    matrix: torch.Tensor
    inverse: torch.Tensor

    @classmethod
    def regular(cls, matrix: torch.Tensor, free: torch.Tensor) -> Metric:
        """Of a matrix that may not be invertible. free: (m,) bool; it is zero for other garment nodes."""
        held = ~_numbers(free)
        diagonal = matrix.diagonal().clone()
        diagonal[held] = diagonal[~held].mean()
        own = torch.where(held, diagonal, 0.0)
        matrix = matrix + torch.diag(own + 1e-3 * diagonal + 1e-5 * diagonal.max())
        inverse = torch.linalg.inv(matrix.double()).float()
        return cls(matrix, (inverse + inverse.mT) / 2)


@dataclass(frozen=True)
class _Point:
    """Garment nodes (B, m, 3, 4), the vertices that they carry (B, n, 3), their energy (B,) float64 and its gradient
    (B, n, 3), contact's energy (B, n) and the band's (B, k) by vertex."""

    nodes: torch.Tensor
    vertices: torch.Tensor
    energy: torch.Tensor
    gradient: torch.Tensor
    contact: torch.Tensor
    band: torch.Tensor

    def or_lower(self, other: _Point) -> _Point:
        """Of each sample what has less energy."""
        lower = other.energy < self.energy

        def chosen(name: str) -> torch.Tensor:
            mine, others = getattr(self, name), getattr(other, name)
            return torch.where(lower.view(-1, *[1] * (mine.dim() - 1)), others, mine)

        return _Point(*(chosen(entry.name) for entry in fields(self)))


class NodeStepSolver:
    """Minimises an incremental potential over garment nodes. free: (m,) bool, those that move.

    `metric` is to be set, from `mean_stiffness`, before the first step.
    """

    metric: Metric

    def __init__(
        self, samples: DressedSamples, potential: IncrementalPotential, skinning: NodeSkinning, free: torch.Tensor
    ) -> None:
        self.samples, self.potential, self.skinning, self.free = samples, potential, skinning, free
        self._hessian = IncrementalHessian(samples.model.garment, potential, len(samples.body), samples.device)
        self._band = torch.as_tensor(samples.wearing.band, device=samples.device).long()
        self._band_stiffness = 2 * BAND_STIFFNESS * samples.rest.vertex_area[samples.worn.rows][:, self._band]
        self._identity = torch.eye(3, device=samples.device)

    def minimise(
        self,
        starts: Sequence[torch.Tensor],
        turns: torch.Tensor,
        gravity: torch.Tensor,
        *,
        newton: int,
        products: int,
        damping: float = FIRST_DAMPING,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Garment nodes (B, m, 3, 4) and vertices (B, n, 3), from the best of `starts` on the bodies posed last.

        turns: (B, m, 3, 3) of the posed garment nodes. gravity: (B, 3). newton: steps; products: in each of them.
        damping: the first one.
        """
        here = self._point(starts[0], self.skinning.vertices(starts[0]), gravity)
        for start in starts[1:]:
            here = here.or_lower(self._point(start, self.skinning.vertices(start), gravity))
        damp = torch.full_like(here.energy, damping)
        for step in range(newton):
            if step % HESSIAN_EVERY == 0:
                self._assemble(here)
            change = turns @ self._direction(here.gradient, turns, damp, products)
            there = self._point(here.nodes + change, here.vertices + self.skinning.vertices(change), gravity)
            damp = damp * torch.where(there.energy < here.energy, COOLING, HEATING)
            here = here.or_lower(there)
        return here.nodes, here.vertices

    def mean_stiffness(self, nodes: torch.Tensor, turns: torch.Tensor, gravity: torch.Tensor) -> torch.Tensor:
        """Second derivative (12 m, 12 m) at garment nodes (B, m, 3, 4), the mean over bodies; the samples of a body
        must be alike."""
        here = self._point(nodes, self.skinning.vertices(nodes), gravity)
        self._assemble(here)
        return self._mean(lambda q: self._times(q, turns))

    def mean_inertia(self, turns: torch.Tensor) -> torch.Tensor:
        """Mass matrix (12 m, 12 m) [kg], the mean over bodies."""
        mass = self.potential.mass[..., None]

        def times(q: torch.Tensor) -> torch.Tensor:
            return turns.mT @ self.skinning.transposed(mass * self.skinning.vertices(turns @ q))

        return self._mean(times)

    def _mean(self, times: Callable[[torch.Tensor], torch.Tensor]) -> torch.Tensor:
        bodies, numbers = len(self.samples.body_set), _numbers(self.free)
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

    def _point(self, nodes: torch.Tensor, vertices: torch.Tensor, gravity: torch.Tensor) -> _Point:
        _, gradient = self.potential.evaluate(vertices, gravity, *self.samples.contact)
        element = self.potential.element_energies
        energy = sum(values.sum(dim=1, dtype=torch.float64) for values in element.values()).nan_to_num(NOT_FINITE)
        return _Point(nodes, vertices, energy, gradient, element["collision"].clone(), element["band"].clone())

    def _assemble(self, here: _Point) -> None:
        self.potential.element_energies["collision"].copy_(here.contact)
        exact = torch.zeros_like(self._hessian.active)
        self._hessian.assemble(here.vertices, *self.samples.contact, exact)
        held = torch.zeros(here.vertices.shape[:2], device=exact.device)
        held[:, self._band] = torch.where(here.band > 0, self._band_stiffness, 0.0)
        none = torch.zeros(len(held), device=exact.device)
        self._hessian.add_to_diagonal((held[..., None, None] * self._identity).contiguous(), none)

    def _times(self, q: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
        """Second derivative times q."""
        with _coarse_products():
            x = self.skinning.vertices(turns @ q)
            product = torch.empty_like(x)
            self._hessian.multiply(x, product)
            return turns.mT @ self.skinning.transposed(product)

    def _direction(
        self, gradient: torch.Tensor, turns: torch.Tensor, damping: torch.Tensor, products: int
    ) -> torch.Tensor:
        free, damp = self.free[:, None, None], damping.float()[:, None, None, None]

        def through(matrix: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
            return (v.flatten(1) @ matrix).view_as(v)

        residual = -(turns.mT @ self.skinning.transposed(gradient)) * free
        step = torch.zeros_like(residual)
        direction = through(self.metric.inverse, residual)
        rho = _dot(residual, direction)
        for _ in range(products):
            product = self._times(direction, turns) * free + damp * through(self.metric.matrix, direction)
            alpha = rho / _dot(direction, product).clamp_min(1e-20)
            step = step + alpha * direction
            residual = residual - alpha * product
            ahead = through(self.metric.inverse, residual)
            previous, rho = rho, _dot(residual, ahead)
            direction = ahead + rho / previous.clamp_min(1e-20) * direction
        return step


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


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a * b).sum(dim=(1, 2, 3), keepdim=True)
