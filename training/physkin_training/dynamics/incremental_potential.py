"""The incremental potential: what one step of implicit Euler minimises over the vertices of a garment.

To the energies at rest come those of motion. The cloth's place and its forecast are those in the world, seen from the
root frame that the step ends in: no fictitious forces are needed.

Dimensions: `B` samples, `n` garment vertices. Metres, root frame, seconds.
"""

from __future__ import annotations

import torch

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_training.energies.motion import Dynamics, TimeStep, energies_of_motion
from physkin_training.physics.physics_losses import PhysicsLosses

__all__ = ["IncrementalPotential"]


class IncrementalPotential(PhysicsLosses):
    """`PhysicsLosses` with the terms of motion, for steps of `step` [s] that `begin` tells where they start from.

    rest_row: (B,), see `PhysicsLosses`, as are the options. Raises ValueError for a step not positive and finite.
    """

    def __init__(
        self,
        garment: Garment,
        material: Material,
        samples: int,
        device: torch.device,
        *,
        step: float,
        dynamics: Dynamics,
        rest_row: torch.Tensor | None = None,
        **options,
    ) -> None:
        super().__init__(garment, material, samples, device, **options)
        if rest_row is not None:
            self.rest_row.copy_(rest_row)
        self.time_step = TimeStep(self.cloth, step, dynamics)
        self.energies += energies_of_motion(self.cloth, self.time_step)

    def begin(self, before: torch.Tensor, forecast: torch.Tensor) -> None:
        """A step begins at `before` and would end at `forecast` without forces, both (B, n, 3) [m], as seen from the
        root frame at its end."""
        self.time_step.before.copy_(before)
        self.time_step.forecast.copy_(forecast)
