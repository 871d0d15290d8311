"""Twenty poses of people who stand, walk, talk and dance: where garments are looked at beside the rest pose.

Dimensions: `P` poses, `d` degrees of freedom.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from physkin_core.rig.rig import Rig

__all__ = ["CHECK_POSES", "everyday_poses"]

CHECK_POSES = Path(__file__).parents[1] / "assets" / "check_poses.safetensors"


def everyday_poses(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions (P, d) [rad] and gravity directions (P, 3).

    Made by `physkin_prepare.everyday_poses`. Raises ValueError for a rig of other joints.
    """
    names, positions, gravity = _stored_poses()
    if names != rig.joint_names:
        raise ValueError(f"everyday poses are of the default rig; this one's joints are {', '.join(rig.joint_names)}")
    return positions, gravity


@cache
def _stored_poses() -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    from safetensors import safe_open

    with safe_open(CHECK_POSES, framework="numpy") as file:
        names = tuple(file.metadata()["joint_names"].split(","))
        return names, file.get_tensor("positions").astype(np.float32), file.get_tensor("gravity").astype(np.float64)
