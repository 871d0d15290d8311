"""The paper doll that panels are sewn around: a body shrunk towards its bones and pressed flat, with arms that move.

Around the body itself, seams would get caught on shoulders and hips, or close in front of an arm.

Dimensions: `t` vertices of a cut, `V` of the body. Metres, root frame, canonical pose.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import Avatar
from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.rig.rig import Rig
from physkin_training.sewing.cut import Cut

__all__ = ["Arms", "paper_doll"]

THIN, FLAT = 0.4, 0.1
"""What is left in the paper doll of the distance from the bones to the skin, and of the bones' distance in front of or
behind the root."""
FAR_END = 0.2
"""Share of a sleeve's vertices, those farthest from the shoulder, in whose middle the arm is to be."""
HIGHEST_ARMS = np.radians(60.0)
"""While sleeves are sewn to the body, they turn upwards as they are as stiff as cardboard. Arms follow up to this."""


def paper_doll(avatar: Avatar, rig: Rig) -> np.ndarray:
    """Vertices (V, 3) [m] of the body shrunk towards its bones and pressed flat. Hands, feet and head shrink to the
    joints where they begin, because they are not in line with a sleeve."""
    last = ~np.isin(np.arange(rig.bone_count), rig.parents)
    ends = np.where(last[:, None], avatar.bone_heads, avatar.bone_tails)
    heads = avatar.bone_heads[avatar.influence_bones]
    bones = ends[avatar.influence_bones] - heads
    along = ((avatar.vertices[:, None] - heads) * bones).sum(axis=2) / np.maximum((bones * bones).sum(axis=2), 1e-12)
    nearest = heads + np.clip(along, 0, 1)[..., None] * bones
    on_bones = (avatar.influence_weights[..., None] * nearest).sum(axis=1)
    drawn_in = np.where(last[avatar.influence_bones], 0.1 * THIN, THIN) * avatar.influence_weights
    thin = drawn_in.sum(axis=1, keepdims=True)
    return on_bones * [FLAT, 1.0, 1.0] + thin * (avatar.vertices - on_bones)


class Arms:
    """The arms of an avatar, which the body and its doll can raise."""

    def __init__(self, avatar: Avatar, rig: Rig) -> None:
        self._sides = []
        for first, _, last in (limb.ends for limb in find_limbs(rig).limbs if limb.is_arm):
            arm, hand = (rig.inherited({bone: 1}, 0) == 1 for bone in (first, last))
            of_arm, of_hand = (
                (bones[avatar.influence_bones] * avatar.influence_weights).sum(axis=1, keepdims=True)
                for bones in (arm, hand)
            )
            shoulder, wrist = avatar.bone_heads[[first, last]].astype(float)
            self._sides.append((of_arm, of_hand, shoulder, wrist, 1.0 if shoulder[1] > 0 else -1.0))
        self.angles = np.zeros(len(self._sides))

    def follow(self, cut: Cut, hung: np.ndarray, closed: np.ndarray) -> None:
        """Point at the far ends of sleeves as a cut is `closed` (t, 3), which it began from `hung` (t, 3); without
        sleeves, out of the way of wide skirts."""
        on_arms = (np.array(cut.labels) == "arm")[cut.panel_of]
        for side, (_, _, shoulder, wrist, outwards) in enumerate(self._sides):
            sleeve = closed[on_arms & (hung[:, 1] * outwards > 0)] - shoulder
            self.angles[side] = HIGHEST_ARMS
            if len(sleeve):
                reach = np.linalg.norm(sleeve[:, 1:], axis=1)
                end = sleeve[reach >= np.quantile(reach, 1 - FAR_END)].mean(axis=0)
                here, there = (np.arctan2(to[2], outwards * to[1]) for to in (wrist - shoulder, end))
                self.angles[side] = np.clip(there - here, 0.0, HIGHEST_ARMS)

    def raised(self, vertices: np.ndarray, left: float = 1.0) -> np.ndarray:
        """Vertices (V, 3) [m] of the body or its doll with arms raised sideways, by what is left of the angles, 0 to
        1."""
        for (of_arm, _, shoulder, _, outwards), angle in zip(self._sides, self.angles):
            turn = Rotation.from_euler("x", outwards * left * angle)
            vertices = vertices + of_arm * (turn.apply(vertices - shoulder) + shoulder - vertices)
        return vertices

    def without_hands(self, vertices: np.ndarray, left: float = 1.0) -> np.ndarray:
        """Vertices (V, 3) [m] of the body with hands drawn in to the wrists, by what is left of that, 0 to 1: forearms
        go through sleeves first, and hands come out of them."""
        for _, of_hand, _, wrist, _ in self._sides:
            vertices = vertices - left * (1 - 0.1 * THIN) * of_hand * (vertices - wrist)
        return vertices
