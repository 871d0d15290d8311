"""The skin of legs, trunk, forearms and hands as smooth surfaces that follow the bones: cloth is kept out of these.

Each part is a `RadialShape` in axes of its own: the trunk about a vertical axis, a thigh or a shin about the line from
hip to ankle, with X forward. The bones that twist a part take over from each other along it. Thigh and shin are two
parts, so that a shin can lie against the thigh. Dimensions: `k` parts, `J` splines, `H` harmonics. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.body_shape.limb_chains import Limb, Limbs
from physkin_core.body_shape.radial_shape import RadialShape, fit_radial_shape
from physkin_core.body_shape.skin_by_part import SkinByPart, SkinPoints, trunk_of
from physkin_core.native_module import native
from physkin_core.rig.rig import Rig

__all__ = ["SkinPart", "fit_skin_parts"]

BLEND = 0.06
"""[m] along the axis over which a bone takes over from the last one."""
FEWEST = 30
"""Skin points that a part must have."""
BEYOND = 0.045
"""[m] by which both reach beyond the knee, which they round when it is bent."""
HEEL, TOES = 0.03, 0.01
"""[m] by which a foot reaches beyond its skin: a part is rounded at its ends, where a heel is not."""
SHORTEST = 1e-3
"""[m] A part is longer."""
MOST_BONES: int = native.constants["skin_bones"]
"""That turn a part."""
MOST_ALONG_X = 0.9
"""Of a leg's direction: one that points forward more than that has its own axes otherwise."""


@dataclass(frozen=True)
class SkinPart:
    """A thigh, a shin, a foot, the trunk, a forearm or a hand.

    shape: in the part's own axes. frame: (3, 4) from canonical points to these axes, the third of them along the part.
    bones: those that turn it, in their order along the axis. heights: [m] along the axis at which each takes over.
    blend: [m] over which it does. presses: whether it is an arm's, which dents cloth instead of carrying it.
    """

    shape: RadialShape
    frame: np.ndarray
    bones: tuple[int, ...]
    heights: tuple[float, ...]
    blend: float
    is_shin: bool = False
    presses: bool = False

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
    """Legs, trunk, forearms and hands of a body, of the limbs found in its rig; those without skin or bones are left
    out. None where there are neither legs nor a trunk."""
    heads = avatar.bone_heads.astype(np.float64)
    skin = SkinByPart(avatar, rig, found)
    parts = []
    for index, limb in enumerate(found.limbs):
        if not limb.is_arm:
            parts += [*_leg(limb, rig, heads, skin, index), *_end(limb, heads, skin.of(3 * index + 2))]
    try:
        trunk = trunk_of(skin, found, heads)
        heights = tuple(heads[list(found.trunk), 2].tolist())
        parts.append(SkinPart(trunk, np.eye(3, 4), found.trunk, heights, BLEND))
    except ValueError:
        pass
    if not parts:
        return ()
    for index, limb in enumerate(found.limbs):
        if limb.is_arm:
            parts += [*_forearm(limb, rig, heads, skin.of(3 * index + 1)), *_end(limb, heads, skin.of(3 * index + 2))]
    return tuple(parts)


def _leg(limb: Limb, rig: Rig, heads: np.ndarray, skin: SkinByPart, index: int) -> list[SkinPart]:
    """Thigh and shin, as far as there are such."""
    hip, knee, ankle = heads[list(limb.ends)]
    length = float(np.linalg.norm(ankle - hip))
    if length < SHORTEST:
        return []
    down = (ankle - hip) / length
    turn = _axes(down)
    own = skin.of(3 * index, 3 * index + 1)
    fold = float((knee - hip) @ down)
    parts = []
    for which, low, high in ((0, 0.0, fold + BEYOND), (1, fold - BEYOND, length)):
        bones = _moving(rig, *limb.ends[which : which + 2])
        heights = ((heads[bones[1:]] - hip) @ down).tolist()
        parts += _along(own, turn, hip, (low, high), bones, heights, is_shin=which == 1)
    return parts


def _forearm(limb: Limb, rig: Rig, heads: np.ndarray, own: SkinPoints) -> list[SkinPart]:
    """One, or none."""
    elbow, wrist = heads[list(limb.ends[1:])]
    length = float(np.linalg.norm(wrist - elbow))
    if length < SHORTEST:
        return []
    down = (wrist - elbow) / length
    bones = _moving(rig, *limb.ends[1:])
    heights = ((heads[bones[1:]] - elbow) @ down).tolist()
    return _along(own, _axes(down), elbow, (0.0, length), bones, heights, presses=True)


def _end(limb: Limb, heads: np.ndarray, own: SkinPoints) -> list[SkinPart]:
    """A hand or a foot, about the longest axis of its skin; or none."""
    if len(own.points) < FEWEST:
        return []
    share = own.areas / own.areas.sum()
    middle = share @ own.points
    along = np.linalg.eigh((own.points - middle).T @ (share[:, None] * (own.points - middle)))[1][:, 2]
    along = along if along @ (middle - heads[limb.ends[2]]) > 0 else -along
    low, high = np.quantile((own.points - middle) @ along, [0.01, 0.99])
    reach = (low, high) if limb.is_arm else (low - HEEL, high + TOES)
    return _along(own, _axes(along), middle, reach, [limb.ends[2]], [], presses=limb.is_arm)


def _axes(down: np.ndarray) -> np.ndarray:
    """(3, 3) unit axes: forward as far as it is across, and, the third, a unit direction (3,)."""
    across = np.eye(3)[0 if abs(down[0]) < MOST_ALONG_X else 1]
    forward = across - (across @ down) * down
    forward /= np.linalg.norm(forward)
    return np.stack([forward, np.cross(down, forward), down])


def _along(
    own: SkinPoints,
    turn: np.ndarray,
    origin: np.ndarray,
    reach: tuple[float, float],
    bones: list[int],
    heights: list[float],
    **kind: bool,
) -> list[SkinPart]:
    """A part fitted to skin within its reach along the last axis of `turn` (3, 3) from its origin (3,), turned by
    bones, which take over at heights from the second on; or none where there is hardly any skin."""
    points = (own.points - origin) @ turn.T
    low, high = reach
    along = (points[:, 2] > low) & (points[:, 2] < high)
    if along.sum() < FEWEST or high - low < SHORTEST:
        return []
    shape = fit_radial_shape(points[along], own.areas[along], low, high)
    frame = np.column_stack([turn, -turn @ origin])
    return [SkinPart(shape, frame, tuple(bones), (low, *heights), BLEND, **kind)]


def _moving(rig: Rig, first: int, last: int) -> list[int]:
    """Bones from `first` to before `last`, at most `MOST_BONES`, that have degrees of freedom; `first` in any case."""
    bones = []
    bone = rig.parents[last]
    while bone != first and bone >= 0:
        bones.append(int(bone))
        bone = rig.parents[bone]
    between = [bone for bone in bones[::-1] if bone in rig.dof_bones]
    return [first, *between][:MOST_BONES]
