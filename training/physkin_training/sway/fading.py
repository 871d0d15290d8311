"""How much of what it learnt each garment node sways: hems and hoods do, cloth that lies on chest and arms does not.

Over chest, shoulders and arms cloth has hardly any way to swing, and what a network cannot foretell there shows as skin
that comes through.

Dimensions: `m` garment nodes. Metres, canonical pose.
"""

from __future__ import annotations

import numpy as np

from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.model.garment_model import GarmentModel

__all__ = ["sway_share"]

FADES_FROM, GONE_FROM = 0.05, 0.3
"""[m] above the root: lower on the trunk all sway is left, higher none."""


def sway_share(model: GarmentModel) -> np.ndarray:
    """(m,) float32, from 0 to 1. Raises ValueError as `find_limbs`."""
    rig, limbs = model.rig, find_limbs(model.rig)
    risen = np.clip((model.node_rest[:, 2] - FADES_FROM) / (GONE_FROM - FADES_FROM), 0, 1)
    share = 1 - risen**2 * (3 - 2 * risen)
    begins = {limb.ends[0]: 0 for limb in limbs.limbs if limb.is_arm} | {limbs.head: 1}
    fixed = rig.inherited(begins, -1)[model.node_bone]
    return np.where(fixed >= 0, fixed, share).astype(np.float32)
