"""Poses of the default rig with left and right exchanged.

Dimensions: `P` poses, `d` degrees of freedom.
"""

from __future__ import annotations

import numpy as np

from physkin_core.rig.rig import Rig

__all__ = ["mirrored"]


def mirrored(rig: Rig, positions: np.ndarray) -> np.ndarray:
    """Joint positions (P, d) [rad] with left and right exchanged."""
    result = np.empty_like(positions)
    names = list(rig.joint_names)
    for index, name in enumerate(names):
        swap = name.replace(".L_", ".\0_").replace(".R_", ".L_").replace(".\0_", ".R_")
        other = names.index(swap)
        sign = -np.sign(rig.dof_axes[index] * [1, -1, 1] @ rig.dof_axes[other])
        result[:, other] = rig.rest[other] + sign * (positions[:, index] - rig.rest[index])
    return np.clip(result, rig.lower, rig.upper)
