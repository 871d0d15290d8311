"""Which model of a run to keep: energy of the averaged networks on bodies and poses that stay the same, each pose
weighted as in training.

A run can end in a worse state than it has been through (docs/notebook/training-runs.md), so the best is kept. The
bodies are training bodies: held-out ones are for the figures, and a model chosen by them would flatter itself.

Dimensions: `k` batches, `B` samples and `S` bodies of a batch, `n` garment vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment import Garment
from physkin_core.model.hyper_modulator import POINT_COUNT
from physkin_core.model.surface_sampling import sample_surface
from physkin_training.config import TrainingConfig
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.rest_data import RestData
from physkin_training.networks.draping import Drape
from physkin_training.networks.made_to_measure import MadeToMeasure
from physkin_training.physics.physics_losses import PhysicsLosses, lightened
from physkin_training.sampling.pose_sampling import PoseSampler
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

__all__ = ["CONTACT_LINEAR_BEYOND", "HEAVY_ENERGY", "BestModel", "Validation"]

CONTACT_LINEAR_BEYOND = 0.01
"""Depth [m] from which contact's force grows no further, while training (see `PhysicsLosses`)."""
HEAVY_ENERGY = 0.1
"""[J] Poses of more energy count less (see `PhysicsLosses`). In a plain mean the few heaviest would decide, which may
rise while all others still fall."""
BATCHES = 4
"""The set is this many times as large as a training step's: four passes forward cost about as much as three steps."""


@dataclass(frozen=True)
class BestModel:
    """The averaged networks and skinning weights of the step with the lowest validation energy [J] so far."""

    step: int
    energy: float
    parameters: dict[str, torch.Tensor]

    @classmethod
    def of(cls, drape: Drape, *, step: int, energy: float) -> BestModel:
        """A copy of what the drape is now."""
        parameters = {name: parameter.detach().clone() for name, parameter in drape.named_parameters()}
        return cls(step, energy, parameters)


class Validation:
    """A fixed set of bodies and poses over the full range; the configuration's seed decides it, on any device.

    All buffers are its own and it draws nothing from torch's random streams, so that neither a recorded step nor the
    samples to come notice it. fits, rest: rest shapes of the set, which is measured both at the template and made to
    measure. Of the last measurement, None before the first: `made_to_measure` [J], that of the latter alone, and
    `strained` [J], that without gravity. `chosen` (k, S) indices of bodies, `positions` (k, B, d) [rad], `gravity`
    (k, B, 3).
    """

    def __init__(
        self,
        config: TrainingConfig,
        body_model: BodyModel,
        garment: Garment,
        bodies: BodySet,
        wearing: Wearing,
        *,
        fits: MadeToMeasure,
        rest: RestData,
    ) -> None:
        device = bodies.vertices.device
        optimisation = config.optimisation
        self._fits = fits
        self.made_to_measure: float | None = None
        self.strained: float | None = None
        generator = torch.Generator().manual_seed(config.seed)
        self.chosen = torch.randint(len(bodies), (BATCHES, optimisation.bodies), generator=generator).to(device)
        sampler = PoseSampler.of_training(body_model.rig, torch.device("cpu"))
        samples = [sampler.sample(optimisation.samples, 1.0, generator=generator) for _ in range(BATCHES)]
        self.positions, self.gravity = (torch.stack(part).to(device) for part in zip(*samples))
        self._per_body = optimisation.samples // optimisation.bodies
        self._points, self._normals = self._surfaces(bodies)
        count = self.positions.shape[1]
        self._posed_bodies = PosedBodies(body_model, bodies, count, faces=wearing.faces)
        self.losses = PhysicsLosses(
            garment,
            config.material,
            count,
            device,
            wearing=wearing,
            linear_beyond=CONTACT_LINEAR_BEYOND,
            leads_back=True,
            rest=rest,
        )

    @torch.no_grad()
    def energy(self, drape: Drape) -> float:
        """Mean energy [J] over the poses, all but gravity `lightened`, at the material's full contact stiffness: about
        what training descends. The mean of the template and made to measure. Waits for the device."""
        means: list[list[torch.Tensor]] = [[], []]
        for batch, chosen in enumerate(self.chosen):
            positions, gravity = self.positions[batch], self.gravity[batch]
            body_index = chosen.repeat_interleave(self._per_body)
            bones = self._posed_bodies.pose(positions, body_index)
            for made in (False, True):
                fit = self._fits.small[chosen] | made
                worn = self._fits.worn(body_index, fit.repeat_interleave(self._per_body))
                self.losses.rest_row.copy_(worn.rows)
                modulation = drape.networks.hyper_modulator(self._points[batch], self._normals[batch], fit.float())
                modulation = modulation.repeat_interleave(self._per_body, dim=0)
                nodes = drape.posed_nodes(bones, worn.node_positions)
                vertices = drape(modulation, positions, gravity, nodes, worn.rest)
                _, energies = self.losses(vertices, gravity, self._posed_bodies.mesh, self._posed_bodies.offset)
                parts = lightened(energies.strained, HEAVY_ENERGY), energies.gravity
                means[made].append(torch.stack([part.mean() for part in parts]))
        measured = torch.stack([torch.stack(each).mean(dim=0) for each in means])
        _, self.made_to_measure = measured.sum(dim=1).tolist()
        self.strained, height = measured.mean(dim=0).tolist()
        return self.strained + height

    def _surfaces(self, bodies: BodySet) -> tuple[torch.Tensor, torch.Tensor]:
        """Points and normals (k, S, N, 3) of the chosen bodies, the ones that the run time takes."""
        vertices, faces = bodies.vertices[self.chosen].cpu().numpy(), bodies.faces.cpu().numpy()
        pairs = [sample_surface(body, faces, POINT_COUNT) for batch in vertices for body in batch]
        shape = (*self.chosen.shape, POINT_COUNT, 3)
        device = bodies.vertices.device
        return tuple(torch.as_tensor(np.stack(part), device=device).view(shape) for part in zip(*pairs))
