"""Body codes: the few numbers by which a sway network knows a body, taken from the modulation of the pose modulator.

Dimensions: `S` bodies, `M` modulation of the pose modulator, `c` code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.sway_network import LARGEST_CODE
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.sampling.posed_bodies import BodySet

__all__ = ["BodyCodes"]

BODIES = 128
SIZE = 12


@dataclass(frozen=True)
class BodyCodes:
    """mean (M,) float32 of modulations; directions (c, M) float32, by which codes have a standard deviation of 1."""

    mean: np.ndarray
    directions: np.ndarray

    @classmethod
    def of(cls, model: GarmentModel, body_model: BodyModel, device: torch.device) -> BodyCodes:
        """Computed from training bodies, in the template and in garments made to measure."""
        drape = drape_from_model(model).to(device).eval()
        chosen = np.random.default_rng(0).permutation(len(body_model.train_bodies))[:BODIES]
        surfaces = BodySet(body_model, body_model.train_bodies[chosen], device).vertices.cpu().numpy()
        modulation = np.concatenate(
            [encode_bodies(drape, surfaces, body_model.faces, fit=fit).cpu().numpy() for fit in (0.0, 1.0)]
        ).astype(np.float64)
        mean = modulation.mean(axis=0)
        _, spread, axes = np.linalg.svd(modulation - mean, full_matrices=False)
        size = min(SIZE, int((spread > 1e-6 * spread[0]).sum()))
        directions = axes[:size] * (np.sqrt(len(modulation)) / spread[:size, None])
        return cls(mean.astype(np.float32), directions.astype(np.float32))

    def __call__(self, modulation: torch.Tensor) -> torch.Tensor:
        """Codes (S, c) of modulations (S, M); twin of `SwayNetwork.body_code`."""
        mean, directions = (torch.as_tensor(a, device=modulation.device) for a in (self.mean, self.directions))
        return ((modulation - mean) @ directions.T).clamp(-LARGEST_CODE, LARGEST_CODE)
