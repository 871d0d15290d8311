"""The bodies of a training run: of all ages as they are, and some of them with something worn under the garment."""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.body_model import BodyModel

__all__ = ["training_bodies"]

LARGEST_SWELLING = 0.015
"""[m] how much may be worn under the garment."""
SWOLLEN = 0.5
"""Share of the bodies that are taken once more, with something under the garment."""
COVERED_PARTS = 0.7
"""Share of a swollen body's parts that are."""


def training_bodies(body_model: BodyModel, count: int, *, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Shape coefficients (S, c) and swelling (S, b) [m]: of the first `count` bodies as they are, then of half of them
    once more, swollen. Dimensions: `b` bones."""
    bodies = body_model.train_bodies[:count]
    again = bodies[: round(SWOLLEN * len(bodies))]
    random = np.random.default_rng(seed)
    shape = (len(again), body_model.rig.bone_count)
    swelling = LARGEST_SWELLING * random.random(shape) * (random.random(shape) < COVERED_PARTS)
    return np.concatenate([bodies, again]), np.concatenate([np.zeros((len(bodies), shape[1])), swelling])
