"""How much of the learnt sway each garment node shows: all of it at hems and hoods, none on chest and arms.

Over chest, shoulders and arms cloth has hardly any room to swing, and where a network is wrong there, skin comes
through.

Dimensions: `m` garment nodes. Metres, canonical pose.
"""

from __future__ import annotations

import numpy as np

from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.model.garment_model import GarmentModel

__all__ = ["sway_share"]

FADES_FROM, GONE_FROM = 0.05, 0.3
"""[m] above the root. Cloth on the trunk sways in full below the first height, and not at all above the second."""


def sway_share(model: GarmentModel) -> np.ndarray:
    """(m,) float32, from 0 to 1. Raises ValueError as `find_limbs`."""
    rig, limbs = model.rig, find_limbs(model.rig)
    risen = np.clip((model.node_rest[:, 2] - FADES_FROM) / (GONE_FROM - FADES_FROM), 0, 1)
    share = 1 - risen**2 * (3 - 2 * risen)
    begins = {limb.ends[0]: 0 for limb in limbs.limbs if limb.is_arm} | {limbs.head: 1}
    fixed = rig.inherited(begins, -1)[model.node_bone]
    return np.where(fixed >= 0, fixed, share).astype(np.float32)
