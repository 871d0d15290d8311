"""Skinning weights of a garment model fitted to its own cloth, by the physics of training, while its networks stay.

What a model that was carried over to another garment does wrong is mostly where its cloth hangs on garment nodes: a few
seconds bring that down to about what minutes of training do. Garment nodes and offsets of detail nodes are computed
once for each pose, so that a step is no more than skinning and energies.

Dimensions: `B` samples of a batch, `n` garment vertices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.rest_data import RestData
from physkin_training.networks.draping import Drape, RestShape
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.networks.made_to_measure import MadeToMeasure
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.sampling.pose_sampling import PoseSampler
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies
from physkin_training.soap import Soap
from physkin_training.train.schedule import LATE_REACH
from physkin_training.train.validation import CONTACT_LINEAR_BEYOND, HEAVY_ENERGY

__all__ = ["fitted_weights"]

BODIES, BATCHES, SAMPLES = 8, 4, 16
"""Training bodies; batches of so many poses each."""
STEPS, VERTEX_STEPS, RATE = 72, 290_000, 0.1
"""Steps of Adam on logits, fewer where the garment has so many vertices that they would take longer; and the first
one's rate, which falls to 0."""
FOR_ENGINES = 2
"""Samples of a batch that are skinned by the weights for engines."""
ENCODER_POINTS = 512
"""Of a body: an eighth of them tells the networks as much."""


@dataclass(frozen=True)
class _Batch:
    """Garment nodes (B, m, 3, 4) and offsets of detail nodes of some poses, on bodies that are posed so, and rest
    shapes, with their rows in the rest data."""

    nodes: torch.Tensor
    detail: torch.Tensor | None
    rest: RestShape
    rows: torch.Tensor
    gravity: torch.Tensor
    posed: PosedBodies

    def skinned(self, drape: Drape, engines: Drape) -> torch.Tensor:
        """Cloth (B, n, 3), the last samples' by the weights for engines."""
        rest = self.rest if self.detail is None else self.rest.moved(drape.vertex_offsets(self.detail))
        parts = slice(None, -FOR_ENGINES), slice(-FOR_ENGINES, None)
        return torch.cat(
            [
                each.skin(self.nodes[part], RestShape(rest.vertices[part], rest.nodes[part]))
                for each, part in zip((drape, engines), parts)
            ]
        )


def fitted_weights(
    model: GarmentModel, body_model: BodyModel, device: torch.device, *, steps: int | None = None
) -> GarmentModel:
    """The model with skinning weights, both sets, and weights of detail nodes for which its cloth is strained less, on
    training bodies in poses as in training: every second one and all on small bodies made to measure.

    Raises ValueError for another rig than the body model's.
    """
    if model.rig.to_json() != body_model.rig.to_json():
        raise ValueError(f"weights are fitted on the body model's bodies; garment model {model.name!r} has another rig")
    garment = model.garment
    steps = steps or min(STEPS, VERTEX_STEPS // len(garment.vertices))
    drape, engines = (drape_from_model(each).to(device).requires_grad_(False) for each in (model, model.for_engines()))
    bodies = BodySet(body_model, body_model.train_bodies[:BODIES], device)
    fits = MadeToMeasure(garment, drape, bodies, body_model)
    wearing = Wearing.of(garment, body_model).worn_faces()
    losses = PhysicsLosses(
        garment,
        model.material,
        SAMPLES,
        device,
        wearing=wearing,
        reach=LATE_REACH,
        linear_beyond=CONTACT_LINEAR_BEYOND,
        leads_back=True,
        heavy_energy=HEAVY_ENERGY,
        rest=RestData(garment, model.material, device, shapes=fits.shapes),
    )
    sampler = PoseSampler.of_training(body_model.rig, torch.device("cpu"))
    generator = torch.Generator().manual_seed(0)
    surfaces = bodies.vertices.cpu().numpy()
    encoded = [
        encode_bodies(drape, surfaces, body_model.faces, fit=fit, points=ENCODER_POINTS) for fit in (0.0, 1.0)
    ]  # at the template, and made to measure
    modulations = torch.stack(encoded)
    batches = []
    for _ in range(BATCHES):
        positions, gravity = (part.to(device) for part in sampler.sample(SAMPLES, 1.0, generator=generator))
        posed = PosedBodies(body_model, bodies, SAMPLES, faces=wearing.faces)
        batches.append(_batch(drape, modulations, fits, posed, positions, gravity))
    logits = [drape.skinning_logits, engines.skinning_logits]
    if drape.has_detail:
        logits.append(drape.detail_logits)
    for each in logits:
        each.requires_grad_(True)
    adam = Soap([], logits, device)
    for step in range(steps):
        batch = batches[step % len(batches)]
        losses.rest_row.copy_(batch.rows)
        energy, _ = losses(batch.skinned(drape, engines), batch.gravity, batch.posed.mesh, batch.posed.offset)
        adam.zero_grad()
        energy.backward()
        adam.param_groups[0]["lr"].fill_(RATE * (1 - step / steps))
        adam.step()
    return _with_weights_of(drape, engines, model)


@torch.no_grad()
def _batch(
    drape: Drape,
    modulations: torch.Tensor,
    fits: MadeToMeasure,
    posed: PosedBodies,
    positions: torch.Tensor,
    gravity: torch.Tensor,
) -> _Batch:
    """Of joint positions (B, d) [rad] and gravity (B, 3), on the bodies in turn. modulations: (2, S, s)."""
    sample = torch.arange(SAMPLES, device=positions.device)
    body = sample % BODIES
    made = fits.small[body] | (sample // BODIES % 2 == 1)
    worn = fits.worn(body, made)
    nodes = drape.posed_nodes(posed.pose(positions, body), worn.node_positions)
    nodes, detail = drape.draped(modulations[made.long(), body], positions, gravity, nodes)
    return _Batch(nodes, detail, worn.rest, worn.rows.to(torch.int32), gravity, posed)


def _with_weights_of(drape: Drape, engines: Drape, model: GarmentModel) -> GarmentModel:
    def as_array(weights: torch.Tensor) -> np.ndarray:
        return weights.detach().cpu().numpy()

    detail = model.detail
    if detail is not None:
        detail = replace(detail, weights=as_array(drape.detail_weights))
    return replace(
        model,
        influence_weights=as_array(drape.skinning_weights),
        engine_weights=as_array(engines.skinning_weights),
        detail=detail,
    )
