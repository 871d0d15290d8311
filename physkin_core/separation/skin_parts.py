"""The skin of legs and trunk as smooth surfaces that follow the bones: what cloth that hangs free is kept out of.

A thigh or a shin is a radius about the way from hip to ankle, as the trunk is one about a vertical axis: `TrunkShape`
in axes of its own, X of them forward. Bones that twist it take over along it. They are apart, so that a shin can lie
against the thigh. Dimensions: `k` parts, `J` splines, `H` harmonics. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.native_module import native
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
MOST_BONES: int = native.constants["skin_bones"]
"""That turn a part."""
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
    is_shin: bool = False

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How deep canonical points (V, 3) are in it, (V,) [m], negative outside."""
        return self.shape.depth(points @ self.frame[:, :3].T + self.frame[:, 3])[0]

    def ways_back(self, points: np.ndarray) -> np.ndarray:
        """(V, 2) in its own axes, which way a shin that folds leads cloth at canonical points (V, 3) back over itself:
        to where it is from the axis, of unit length behind, and zero in front, where the thigh is between, and of other
        parts."""
        if not self.is_shin:
            return np.zeros((len(points), 2))
        away = points @ self.frame[:2, :3].T + self.frame[:2, 3] - self.shape.centre
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        return away * np.clip(-2 * away[:, :1], 0, 1)


def fit_skin_parts(avatar: Avatar, rig: Rig, found: Limbs) -> tuple[SkinPart, ...]:
    """Legs and trunk of a body, of the limbs found in its rig; those without skin or bones are left out."""
    heads = avatar.bone_heads.astype(np.float64)
    skin = SkinByPart(avatar, rig, found)
    legs = [(index, limb) for index, limb in enumerate(found.limbs) if not limb.is_arm]
    parts = [part for index, limb in legs for part in _leg(limb, rig, heads, skin, index)]
    try:
        trunk = trunk_of(skin, found, heads)
    except ValueError:
        return tuple(parts)
    heights = tuple(heads[list(found.trunk), 2].tolist())
    return (*parts, SkinPart(trunk, np.eye(3, 4), found.trunk, heights, BLEND))


def _leg(limb: Limb, rig: Rig, heads: np.ndarray, skin: SkinByPart, index: int) -> list[SkinPart]:
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
    for which, low, high in ((0, 0.0, fold + BEYOND), (1, fold - BEYOND, length)):
        along = (points[:, 2] > low) & (points[:, 2] < high)
        if along.sum() >= FEWEST:
            shape = fit_trunk(points[along], own.areas[along], low, high)
            first, *twisting = _moving(rig, *limb.ends[which : which + 2])
            heights = (low, *((heads[twisting] - hip) @ down).tolist())
            parts.append(SkinPart(shape, frame, (first, *twisting), heights, BLEND, which == 1))
    return parts


def _moving(rig: Rig, first: int, last: int) -> list[int]:
    """Bones from `first` to before `last`, at most `MOST_BONES`, that have degrees of freedom; `first` in any case."""
    bones = []
    bone = rig.parents[last]
    while bone != first and bone >= 0:
        bones.append(int(bone))
        bone = rig.parents[bone]
    between = [bone for bone in bones[::-1] if bone in rig.dof_bones]
    return [first, *between][:MOST_BONES]
