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
from physkin_core.sway.frame_input import STANDARD_GRAVITY
from physkin_training.physics.energy_hessian import EnergyHessian, corner_gradient
from physkin_training.physics.energy_kernels import add_membrane_forces, deformation_columns
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
def strain(f1: wp.vec3, f2: wp.vec3) -> wp.vec3:
    """Entries 11, 22, 12 of the Green strain of a deformation gradient with these columns."""
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
    f1, f2 = deformation_columns(x[s, b] - x[s, a], x[s, c] - x[s, a], inverse)
    was1, was2 = deformation_columns(before[s, b] - before[s, a], before[s, c] - before[s, a], inverse)
    e = strain(f1, f2) - strain(was1, was2)
    trace = e[0] + e[1]
    energy[s, t] = area * (mu * (e[0] * e[0] + e[1] * e[1] + 2.0 * e[2] * e[2]) + 0.5 * lam * trace * trace)
    stress = wp.vec3(2.0 * mu * e[0] + lam * trace, 2.0 * mu * e[1] + lam * trace, 2.0 * mu * e[2])
    add_membrane_forces(gradient, s, wp.vec3i(a, b, c), f1, f2, stress, inverse, area)


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
    inverse = rest_inverse[rest_row[s], t]
    area = rest_area[rest_row[s], t]
    f1, f2 = deformation_columns(x[s, faces[t, 1]] - x0, x[s, faces[t, 2]] - x0, inverse)
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
