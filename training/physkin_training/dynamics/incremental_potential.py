"""The incremental potential: what one step of implicit Euler minimises over the vertices of a garment.

To the energies at rest come inertia, m / (2 h^2) |x - (x_before + h v)|^2, air drag against still air,
m c / (2 h) |x - x_before|^2, and what cloth loses inside itself: the membrane's energy of the change of strain in the
step, times its relaxation time over h (Kelvin and Voigt's solid). The cloth's place and its forecast are those in the
world, seen from the root frame that the step ends in: no fictitious forces are needed.

Dimensions: `B` samples, `n` garment vertices, `f` faces. Metres, root frame, seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import torch
import warp as wp

from physkin_core.model.garment import Garment
from physkin_core.runtime.draper import STANDARD_GRAVITY
from physkin_training.physics.energy_hessian import EnergyHessian, corner_gradient
from physkin_training.physics.physics_losses import PhysicsLosses

__all__ = ["Dynamics", "IncrementalHessian", "IncrementalPotential"]


@dataclass(frozen=True)
class Dynamics:
    """What moves cloth besides its energies.

    air_drag [1/s]: deceleration over speed through still air. relaxation [s] of the membrane: its viscosity over its
    stiffness. Raises ValueError for a value that is not finite or negative.
    """

    air_drag: float = 2.0
    relaxation: float = 0.01

    def __post_init__(self) -> None:
        for name in (entry.name for entry in fields(self)):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}, allowed: a finite number of 0 or more")


@wp.func
def strain(
    x: wp.array2d(dtype=wp.vec3), s: wp.int32, a: wp.int32, b: wp.int32, c: wp.int32, inverse: wp.mat22
) -> wp.vec3:
    """Entries 11, 22, 12 of a face's Green strain."""
    d1 = x[s, b] - x[s, a]
    d2 = x[s, c] - x[s, a]
    f1 = d1 * inverse[0, 0] + d2 * inverse[1, 0]
    f2 = d1 * inverse[0, 1] + d2 * inverse[1, 1]
    return wp.vec3(0.5 * (wp.dot(f1, f1) - 1.0), 0.5 * (wp.dot(f2, f2) - 1.0), 0.5 * wp.dot(f1, f2))


@wp.kernel
def strain_rate_kernel(
    x: wp.array2d(dtype=wp.vec3),
    before: wp.array2d(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    faces: wp.array2d(dtype=wp.int32),
    rest_inverse: wp.array2d(dtype=wp.mat22),
    rest_area: wp.array2d(dtype=wp.float32),
    mu: wp.float32,
    lam: wp.float32,
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """StVK energy of the change of strain since `before`; mu and lam are times relaxation / step."""
    s, t = wp.tid()
    a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
    inverse = rest_inverse[rest_row[s], t]
    area = rest_area[rest_row[s], t]
    e = strain(x, s, a, b, c, inverse) - strain(before, s, a, b, c, inverse)
    trace = e[0] + e[1]
    energy[s, t] = area * (mu * (e[0] * e[0] + e[1] * e[1] + 2.0 * e[2] * e[2]) + 0.5 * lam * trace * trace)
    d1 = x[s, b] - x[s, a]
    d2 = x[s, c] - x[s, a]
    f1 = d1 * inverse[0, 0] + d2 * inverse[1, 0]
    f2 = d1 * inverse[0, 1] + d2 * inverse[1, 1]
    s11 = 2.0 * mu * e[0] + lam * trace
    s22 = 2.0 * mu * e[1] + lam * trace
    s12 = 2.0 * mu * e[2]
    p1 = (f1 * s11 + f2 * s12) * area
    p2 = (f1 * s12 + f2 * s22) * area
    g1 = p1 * inverse[0, 0] + p2 * inverse[0, 1]
    g2 = p1 * inverse[1, 0] + p2 * inverse[1, 1]
    wp.atomic_add(gradient, s, b, g1)
    wp.atomic_add(gradient, s, c, g2)
    wp.atomic_add(gradient, s, a, -g1 - g2)


@wp.kernel
def strain_rate_hessian_kernel(
    active: wp.array(dtype=wp.bool),
    x: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    slots: wp.array2d(dtype=wp.int32),
    rest_row: wp.array(dtype=wp.int32),
    rest_inverse: wp.array2d(dtype=wp.mat22),
    rest_area: wp.array2d(dtype=wp.float32),
    mu: wp.float32,
    lam: wp.float32,
    blocks: wp.array2d(dtype=wp.mat33),
):
    """The positive part, which leaves out the stress of the change of strain; see `stretch_hessian_kernel`."""
    s, t = wp.tid()
    if not active[s]:
        return
    x0 = x[s, faces[t, 0]]
    d1 = x[s, faces[t, 1]] - x0
    d2 = x[s, faces[t, 2]] - x0
    inverse = rest_inverse[rest_row[s], t]
    area = rest_area[rest_row[s], t]
    f1 = d1 * inverse[0, 0] + d2 * inverse[1, 0]
    f2 = d1 * inverse[0, 1] + d2 * inverse[1, 1]
    left = wp.outer(f1, f1) + wp.outer(f2, f2)
    for a in range(3):
        ga = corner_gradient(inverse, a)
        ua = f1 * ga[0] + f2 * ga[1]
        for b in range(3):
            gb = corner_gradient(inverse, b)
            ub = f1 * gb[0] + f2 * gb[1]
            block = lam * wp.outer(ua, ub) + mu * (wp.outer(ub, ua) + wp.dot(ga, gb) * left)
            wp.atomic_add(blocks, s, slots[t, 3 * a + b], area * block)


class IncrementalPotential(PhysicsLosses):
    """`PhysicsLosses` with the terms of motion, for steps of `step` [s] that `begin` tells where they start from.

    rest_row: (B,), see `PhysicsLosses`, as are the options. Raises ValueError for a step not positive and finite.
    """

    def __init__(
        self,
        garment: Garment,
        material,
        samples: int,
        device: torch.device,
        *,
        step: float,
        dynamics: Dynamics,
        rest_row: torch.Tensor | None = None,
        **options,
    ) -> None:
        if not (math.isfinite(step) and step > 0):
            raise ValueError(f"step must be positive and finite, got {step} s")
        super().__init__(garment, material, samples, device, **options)
        self.step, self.dynamics = step, dynamics
        if rest_row is not None:
            self.rest_row.copy_(rest_row)
        n = len(garment.vertices)
        self.before = torch.zeros(samples, n, 3, device=device)
        self.forecast = torch.zeros(samples, n, 3, device=device)
        self._element |= {
            "strain_rate": torch.zeros(samples, len(garment.faces), device=device),
            "inertia": torch.zeros(samples, n, device=device),
            "drag": torch.zeros(samples, n, device=device),
        }

    @property
    def mass(self) -> torch.Tensor:
        """Mass (B, n) [kg] of the vertices, in the rest shape that each sample has."""
        return self.rest.weight[self.rest_row.long()] / STANDARD_GRAVITY

    @property
    def viscosity(self) -> tuple[float, float]:
        """The membrane's two stiffnesses [N/m] times relaxation / step."""
        factor = self.dynamics.relaxation / self.step
        return self._mu * factor, self._lam * factor

    def begin(self, before: torch.Tensor, forecast: torch.Tensor) -> None:
        """A step begins at `before` and would end at `forecast` without forces, both (B, n, 3) [m], as seen from the
        root frame at its end."""
        self.before.copy_(before)
        self.forecast.copy_(forecast)

    def evaluate(
        self, x: torch.Tensor, gravity: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """As `PhysicsLosses.evaluate`, with the terms of motion among the energies: strain_rate, inertia, drag."""
        _, gradient = super().evaluate(x, gravity, body, body_offset)
        x = x.detach().contiguous()
        wp.launch(
            strain_rate_kernel,
            dim=(len(x), self._faces.shape[0]),
            inputs=[
                *(wp.from_torch(x, dtype=wp.vec3), wp.from_torch(self.before, dtype=wp.vec3)),
                *(wp.from_torch(self.rest_row), self._faces),
                *(wp.from_torch(self.rest.rest_inverse, dtype=wp.mat22), wp.from_torch(self.rest.face_area)),
                *self.viscosity,
            ],
            outputs=[wp.from_torch(self._element["strain_rate"]), wp.from_torch(gradient, dtype=wp.vec3)],
            device=self.device,
        )
        kinetic, drag = self.mass / self.step**2, self.mass * (self.dynamics.air_drag / self.step)
        away, way = x - self.forecast, x - self.before
        self._element["inertia"].copy_(0.5 * kinetic * (away * away).sum(dim=2))
        self._element["drag"].copy_(0.5 * drag * (way * way).sum(dim=2))
        gradient += kinetic[:, :, None] * away + drag[:, :, None] * way
        return {name: tensor.sum(dim=1) for name, tensor in self._element.items()}, gradient


class IncrementalHessian(EnergyHessian):
    """Second derivative of an `IncrementalPotential`."""

    def __init__(self, garment: Garment, potential: IncrementalPotential, samples: int, device: torch.device) -> None:
        super().__init__(garment, potential, samples, device)
        self._diagonal_index = wp.to_torch(self._diagonal).long()
        self._identity = torch.eye(3, device=device)

    def assemble(self, x: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor, exact: torch.Tensor) -> None:
        """As `EnergyHessian.assemble`, with the terms of motion."""
        super().assemble(x, body, body_offset, exact)
        potential = self.losses
        wp.launch(
            strain_rate_hessian_kernel,
            dim=(len(x), self._faces.shape[0]),
            inputs=[
                *(wp.from_torch(self.active), wp.from_torch(x.contiguous(), dtype=wp.vec3)),
                *(self._faces, self._face_slots, wp.from_torch(potential.rest_row)),
                *(wp.from_torch(potential.rest.rest_inverse, dtype=wp.mat22), wp.from_torch(potential.rest.face_area)),
                *potential.viscosity,
            ],
            outputs=[self._matrices(self._blocks)],
            device=self.device,
        )
        stiffness = potential.mass * (1 / potential.step**2 + potential.dynamics.air_drag / potential.step)
        stiffness = stiffness * self.active[:, None]
        self._blocks[:, self._diagonal_index] += stiffness[:, :, None, None] * self._identity
