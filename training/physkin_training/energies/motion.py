"""What moves cloth in one step of time: inertia, air drag, and what cloth loses inside itself.

In a step of h seconds: inertia m / (2 h^2) |x - (x_before + h v)|^2, air drag against still air
m c / (2 h) |x - x_before|^2 (wind w adds the uniform pull m c w, which is a part of gravity), and the membrane's energy
of the change of strain, times its relaxation time over h (Kelvin and Voigt's solid).

Dimensions: `B` samples, `n` garment vertices. Metres, root frame, seconds.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import torch

from physkin_core.runtime.frame_input import AIR_DRAG, STANDARD_GRAVITY
from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, view
from physkin_training.energies.stretch import Stretch
from physkin_training.quiet_warp import wp

__all__ = ["Dynamics", "TimeStep", "energies_of_motion"]


@dataclass(frozen=True)
class Dynamics:
    """What moves cloth besides its energies.

    air_drag [1/s]: deceleration over speed through still air. relaxation [s] of the membrane: its viscosity over its
    stiffness. Raises ValueError for a value that is not finite or negative.
    """

    air_drag: float = AIR_DRAG
    relaxation: float = 0.01

    def __post_init__(self) -> None:
        for name in (entry.name for entry in fields(self)):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}, allowed: a finite number of 0 or more")

    def effective_gravity(self, turn: np.ndarray, wind: np.ndarray) -> np.ndarray:
        """Gravity (T, 3) with the pull of the wind, in root frames, in units of gravity. turn: (T, 3, 3) of the root in
        the world; wind: (T, 3) [m/s]."""
        pull = self.air_drag / STANDARD_GRAVITY * wind - [0.0, 0.0, 1.0]
        return np.einsum("tij,ti->tj", turn, pull)


class TimeStep:
    """A step of `seconds`, which may be changed, from `before` to where cloth would be without forces, `forecast`; both
    (B, n, 3) as seen from the root frame at its end. Raises ValueError for a step not positive and finite."""

    def __init__(self, cloth: Cloth, seconds: float, dynamics: Dynamics) -> None:
        if not (math.isfinite(seconds) and seconds > 0):
            raise ValueError(f"step must be positive and finite, got {seconds} s")
        self.cloth, self.seconds, self.dynamics = cloth, seconds, dynamics
        self.before, self.forecast = (cloth.zeros(len(cloth.garment.vertices), 3) for _ in range(2))

    @property
    def mass(self) -> torch.Tensor:
        """Mass (B, n) [kg] of the vertices, in the rest shape that each sample has."""
        return self.cloth.rest.weight[self.cloth.rest_row.long()] / STANDARD_GRAVITY

    def resistance(self, vertices: torch.Tensor) -> torch.Tensor:
        """Gradient (B, n, 3) [N] of inertia and drag for a step that ends at vertices (B, n, 3)."""
        inertia = (vertices - self.forecast) / self.seconds**2
        drag = (vertices - self.before) * (self.dynamics.air_drag / self.seconds)
        return self.mass[..., None] * (inertia + drag)


class Pull(Energy):
    """k / 2 |x - place|^2 of every vertex, with k (B, n) [N/m]."""

    def __init__(self, name: str, cloth: Cloth, place: torch.Tensor, stiffness: Callable[[], torch.Tensor]) -> None:
        super().__init__(cloth, np.arange(len(cloth.garment.vertices))[:, None])
        self.name, self._place, self._stiffness = name, place, stiffness

    def evaluate(self, drapes: Drapes) -> None:
        stiffness, away = self._stiffness(), wp.to_torch(drapes.x) - self._place
        self.values.copy_(0.5 * stiffness * (away * away).sum(dim=2))
        wp.to_torch(drapes.gradient).add_(stiffness[:, :, None] * away)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._add_vertex_blocks(blocks, wp.from_torch(self._stiffness()))


class StrainRate(Stretch):
    """Stretch from where the cloth was, by relaxation / step of its stiffness."""

    name = "strain_rate"

    def __init__(self, cloth: Cloth, step: TimeStep) -> None:
        super().__init__(cloth, unstressed=view(step.before))
        self._step = step

    @property
    def lame(self) -> tuple[float, float]:
        """mu and lambda [N/m] times relaxation / step."""
        mu, lam = self.cloth.lame
        factor = self._step.dynamics.relaxation / self._step.seconds
        return mu * factor, lam * factor


def energies_of_motion(cloth: Cloth, step: TimeStep) -> list[Energy]:
    """Strain rate, inertia and drag, which follow the step as it changes."""
    return [
        StrainRate(cloth, step),
        Pull("inertia", cloth, step.forecast, lambda: step.mass / step.seconds**2),
        Pull("drag", cloth, step.before, lambda: step.mass * (step.dynamics.air_drag / step.seconds)),
    ]
