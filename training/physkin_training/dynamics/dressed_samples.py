"""A garment model on posed bodies, many samples at once: what a simulation poses, drapes and takes energies of.

Dimensions: `B` samples, `S` bodies, `d` degrees of freedom, `m` garment nodes, `n` vertices. Metres, root frame.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.runtime.garment_on_body import checked_fit
from physkin_training.contact.wearing import Wearing
from physkin_training.dynamics.incremental_potential import IncrementalPotential
from physkin_training.energies.motion import Dynamics
from physkin_training.energies.rest_data import RestData
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.networks.made_to_measure import MadeToMeasure
from physkin_training.quiet_warp import wp
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

__all__ = ["DressedSamples"]

REACH = 0.1
"""The body is looked for up to this distance [m]."""


class DressedSamples:
    """Sample `s` is body `body[s]` in the garment.

    bodies: (S, c) shape coefficients of `body_model`. body: (B,) int64 into them. one_size: (S,) bool, bodies that
    wear the template if they are not small, the others what is made to measure; default none. Raises ValueError for
    another rig.
    """

    def __init__(
        self,
        model: GarmentModel,
        body_model: BodyModel,
        bodies: np.ndarray,
        body: torch.Tensor,
        *,
        one_size: np.ndarray | None = None,
    ) -> None:
        self.model, self.body, self.device = model, body, body.device
        checked_fit(model, 1.0)
        self.body_set = BodySet(body_model, bodies, self.device)
        self.wearing = Wearing.of(model.garment, body_model).worn_faces()  # as in training
        self.posed_bodies = PosedBodies(body_model, self.body_set, len(body), faces=self.wearing.faces)
        self.drape = drape_from_model(model).to(self.device).eval()
        fits = MadeToMeasure(model.garment, self.drape, self.body_set, body_model)
        template = torch.as_tensor(np.zeros(len(bodies), bool) if one_size is None else one_size, device=self.device)
        template = template & ~fits.small
        self.worn = fits.worn(body, ~template[body])
        self.rest = RestData(model.garment, model.material, self.device, shapes=fits.shapes)
        surfaces = self.body_set.vertices.cpu().numpy()
        self.body_modulation = encode_bodies(self.drape, surfaces, body_model.faces, fit=1.0)
        """(S, s), see `encode_bodies`."""
        if template.any():
            plain = encode_bodies(self.drape, surfaces, body_model.faces)
            self.body_modulation = torch.where(template[:, None], plain, self.body_modulation)
        self._modulation = self.body_modulation[body]

    def potential(self, step: float, dynamics: Dynamics) -> IncrementalPotential:
        """What a step of so many seconds minimises."""
        return IncrementalPotential(
            *(self.model.garment, self.model.material, len(self.body), self.device),
            step=step,
            dynamics=dynamics,
            wearing=self.wearing,
            reach=REACH,
            rest=self.rest,
            rest_row=self.worn.rows,
        )

    @property
    def contact(self) -> tuple[wp.Mesh, torch.Tensor]:
        """Contact mesh of all bodies as posed last, and where each is in it; see `PosedBodies`."""
        return self.posed_bodies.mesh, self.posed_bodies.offset

    def pose(self, positions: torch.Tensor) -> torch.Tensor:
        """Pose the bodies at joint positions (B, d) [rad]; returns their posed garment nodes (B, m, 3, 4)."""
        return self.drape.posed_nodes(self.posed_bodies.pose(positions, self.body), self.worn.node_positions)

    def draped(
        self, positions: torch.Tensor, gravity: torch.Tensor, posed: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Garment nodes (B, m, 3, 4) as the model corrects the posed ones, and offsets of rest vertices (B, n, 3) [m]
        by its detail, None of a garment without any. gravity: (B, 3)."""
        nodes, detail = self.drape.draped(self._modulation, positions, gravity, posed)
        return nodes, None if detail is None else self.drape.vertex_offsets(detail)

    def skinned(self, nodes: torch.Tensor, offsets: torch.Tensor | None = None) -> torch.Tensor:
        """Vertices (B, n, 3) of the samples' rest shapes, moved by offsets (B, n, 3) where there are any and carried by
        garment nodes (B, m, 3, 4)."""
        return self.drape.skin(nodes, self.worn.rest.moved(offsets))
