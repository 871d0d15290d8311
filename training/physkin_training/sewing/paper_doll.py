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
        for first in (limb.ends[0] for limb in find_limbs(rig).limbs if limb.is_arm):
            arm = rig.inherited({first: 1}, 0) == 1
            share = (arm[avatar.influence_bones] * avatar.influence_weights).sum(axis=1, keepdims=True)
            joint = avatar.bone_heads[first]
            self._sides.append((share, joint, 1.0 if joint[1] > 0 else -1.0))
        self.angles = np.zeros(len(self._sides))

    def follow(self, cut: Cut, hung: np.ndarray, closed: np.ndarray) -> None:
        """Be raised as far as sleeves have turned on their way from `hung` to `closed`, both (t, 3) of a cut."""
        on_arms = (np.array(cut.labels) == "arm")[cut.panel_of]
        for side, (_, _, upwards) in enumerate(self._sides):
            sleeve = on_arms & (hung[:, 1] * upwards > 0)
            if sleeve.any():
                before, after = (shape[sleeve, 1:] - shape[sleeve, 1:].mean(axis=0) for shape in (hung, closed))
                crossed, along = before.T @ after @ [[0.0, -1.0], [1.0, 0.0]], (before * after).sum()
                self.angles[side] = np.clip(upwards * np.arctan2(np.trace(crossed), along), 0.0, HIGHEST_ARMS)

    def raised(self, vertices: np.ndarray, share: float = 1.0) -> np.ndarray:
        """Vertices (V, 3) [m] of the body or its doll with arms raised sideways by a share of their angles."""
        for (arm, joint, upwards), angle in zip(self._sides, self.angles):
            turn = Rotation.from_euler("x", upwards * share * angle)
            vertices = vertices + arm * (turn.apply(vertices - joint) + joint - vertices)
        return vertices
