"""The skin of legs and trunk as smooth surfaces that follow the bones: what cloth that hangs free is kept out of.

A thigh or a shin is a radius about the way from hip to ankle, as the trunk is one about a vertical axis: `TrunkShape`
in axes of its own. They are apart, so that a shin can lie against the thigh. Dimensions: `k` parts, `J` splines, `H`
harmonics. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.rig.rig import Rig
from physkin_core.separation.collision_shape import SkinByPart, trunk_of
from physkin_core.separation.limb_chains import Limb, Limbs
from physkin_core.separation.trunk_shape import TrunkShape, fit_trunk

__all__ = ["SkinPart", "fit_skin_parts"]

BLEND = 0.06
"""[m] along the axis over which a bone takes over from the last one."""
FEWEST = 30
"""Skin points that a thigh or a shin must have."""
BEYOND = 0.045
"""[m] by which both reach beyond the knee, which they round when it is bent."""
MOST_ALONG_X = 0.9
"""Of a leg's direction: one that points forward more than that has its own axes otherwise."""


@dataclass(frozen=True)
class SkinPart:
    """A thigh, a shin or the trunk.

    frame: (3, 4) from canonical points to the part's own axes, the third of them along it. bones: those that turn it,
    in their order along the axis. heights: [m] along the axis that each takes over at. blend: [m] over how much.
    """

    shape: TrunkShape
    frame: np.ndarray
    bones: tuple[int, ...]
    heights: tuple[float, ...]
    blend: float

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How deep canonical points (V, 3) are in it, (V,) [m], negative outside."""
        return self.shape.depth(points @ self.frame[:, :3].T + self.frame[:, 3])[0]


def fit_skin_parts(avatar: Avatar, rig: Rig, found: Limbs) -> tuple[SkinPart, ...]:
    """Legs and trunk of a body, of the limbs found in its rig; those without skin or bones are left out."""
    heads = avatar.bone_heads.astype(np.float64)
    skin = SkinByPart(avatar, rig, found)
    legs = [(index, limb) for index, limb in enumerate(found.limbs) if not limb.is_arm]
    parts = [part for index, limb in legs for part in _leg(limb, heads, skin, index)]
    try:
        trunk = trunk_of(skin, found, heads)
    except ValueError:
        return tuple(parts)
    heights = tuple(heads[list(found.trunk), 2].tolist())
    return (*parts, SkinPart(trunk, np.eye(3, 4), found.trunk, heights, BLEND))


def _leg(limb: Limb, heads: np.ndarray, skin: SkinByPart, index: int) -> list[SkinPart]:
    """Thigh and shin, as far as there are such."""
    hip, knee, ankle = heads[list(limb.ends)]
    length = float(np.linalg.norm(ankle - hip))
    if length < 1e-3:
        return []
    down = (ankle - hip) / length
    across = np.eye(3)[0 if abs(down[0]) < MOST_ALONG_X else 1]
    forward = across - (across @ down) * down
    forward /= np.linalg.norm(forward)
    turn = np.stack([forward, np.cross(down, forward), down])
    frame = np.column_stack([turn, -turn @ hip])
    own = skin.of(3 * index, 3 * index + 1)
    points = (own.points - hip) @ turn.T
    fold = float((knee - hip) @ down)
    parts = []
    for bone, low, high in ((limb.ends[0], 0.0, fold + BEYOND), (limb.ends[1], fold - BEYOND, length)):
        along = (points[:, 2] > low) & (points[:, 2] < high)
        if along.sum() >= FEWEST:
            shape = fit_trunk(points[along], own.areas[along], low, high)
            parts.append(SkinPart(shape, frame, (bone,), (low,), BLEND))
    return parts
