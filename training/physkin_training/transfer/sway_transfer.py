"""A sway network for a model whose networks were trained on from those of the model that it was learnt for.

It moves the same garment nodes. It reads a code from a body's modulation, and training changes modulations; so the code
is read in another way, such that every body keeps its code.

Dimensions: `S` bodies, each in the template and made to measure; `M` modulation of the pose modulator, `c` code.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.sway_network import SwayNetwork
from physkin_training.networks.export import drape_from_model, encode_bodies

__all__ = ["transferred_sway"]

BODIES, POINTS = 64, 512
"""Adult training bodies, as an older model knows no others, and points of each that the encoder sees: an eighth of all,
as for rounding."""
RIDGE = 1e-2
"""Of the largest spread of modulations; below it, directions are not told apart by so few bodies."""


def transferred_sway(
    start: GarmentModel, model: GarmentModel, body_model: BodyModel, device: torch.device
) -> SwayNetwork:
    """The sway network of `start`, which has one, for `model`, which has its garment nodes and was trained from it."""
    sway = start.sway
    adults = body_model.train_adults
    chosen = adults[np.random.default_rng(0).permutation(len(adults))[:BODIES]]
    surfaces = np.stack([body_model.vertices(body) for body in chosen])

    def modulations(each: GarmentModel) -> np.ndarray:
        drape = drape_from_model(each).to(device)
        parts = [encode_bodies(drape, surfaces, body_model.faces, fit=fit, points=POINTS) for fit in (0.0, 1.0)]
        return torch.cat(parts).cpu().numpy().astype(np.float64)

    before, after = modulations(start), modulations(model)  # (2 S, M)
    codes = (before - sway.code_mean) @ sway.code_directions.T.astype(np.float64)
    mean = after.mean(axis=0)
    left, spread, axes = np.linalg.svd(after - mean, full_matrices=False)
    shrunk = spread / (spread**2 + (RIDGE * spread[0]) ** 2)
    directions = (codes.T @ left * shrunk) @ axes  # (c, M); codes are 0 on average
    return replace(sway, code_mean=mean.astype(np.float32), code_directions=directions.astype(np.float32))
