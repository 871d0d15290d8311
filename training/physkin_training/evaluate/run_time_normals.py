"""The normals that the run time gives with a drape.

Dimensions: `S` bodies, `B` samples, `n` garment vertices.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.outfit.draper import Draper

__all__ = ["RunTimeNormals"]


class RunTimeNormals:
    """Of a garment on bodies that are made of coefficients (S, c), which it is put on when they come first. fit: as in
    `Draper`."""

    def __init__(self, model: GarmentModel, body_model: BodyModel, coefficients: np.ndarray, *, fit: float) -> None:
        self._model, self._body_model, self._coefficients, self._fit = model, body_model, coefficients, fit
        self._drapers: dict[int, Draper] = {}

    def __call__(self, positions: torch.Tensor, gravity: torch.Tensor, body: torch.Tensor) -> torch.Tensor:
        """Unit normals (B, n, 3) at joint positions (B, d) [rad] under gravity (B, 3) on bodies (B,) of the S."""
        poses = zip(positions.cpu().numpy(), gravity.cpu().numpy(), body.tolist())
        normals = [self._draper(index).drape(joints, down)[:, 3:].copy() for joints, down, index in poses]
        return torch.as_tensor(np.stack(normals), dtype=torch.float32, device=positions.device)

    def _draper(self, body: int) -> Draper:
        if body not in self._drapers:
            avatar = avatar_from_body(self._body_model, self._coefficients[body])
            self._drapers[body] = Draper(self._model, avatar, fit=self._fit)
        return self._drapers[body]
