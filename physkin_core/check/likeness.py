"""How far an avatar is from the bodies that garments were trained on.

Dimensions: `b` bones, `c` shape coefficients, `P` poses. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.shape_fitting import lay_body
from physkin_core.check.thinned_body import thinned
from physkin_core.model.garment import vertex_normals
from physkin_core.rig.rig import Rig

__all__ = ["Likeness", "body_overlap", "likeness"]

MEASURED_POINTS = 2000
"""Skin points that are looked for inside other parts."""
OF_THAT_STATURE = 64
"""Training bodies nearest in stature that a shape is compared with."""
UNDER_SKIN = 0.004
"""Depth [m] at which a point is asked how many layers of body it is in."""


@dataclass(frozen=True)
class Likeness:
    """The avatar against the body of the body model that is most like it.

    shape_deviation: root mean square of its shape coefficients, from those of the average training body of its stature
    and in standard deviations of such bodies (1 is usual, 2 is rare).
    skin_distance_mm: mean distance of the skin. longest_ratio, longest_bone: of the bone whose length differs most,
    avatar over body. pivot_distance_mm, pivot_bone: of the joint that lies farthest from where the body has it.
    """

    shape_deviation: float
    skin_distance_mm: float
    longest_ratio: float
    longest_bone: str
    pivot_distance_mm: float
    pivot_bone: str


def likeness(avatar: Avatar, rig: Rig) -> Likeness:
    """Measure an avatar of the default rig; some tenths of a second."""
    body = load_body_model()
    laid = lay_body(avatar, body)
    heads, tails = body.bones(laid.coefficients)
    own = np.linalg.norm(avatar.bone_tails - avatar.bone_heads, axis=1)
    ratio = own / np.maximum(np.linalg.norm(tails - heads, axis=1), 1e-6)
    longest = int(np.abs(np.log(np.maximum(ratio, 1e-6))).argmax())
    apart = np.linalg.norm(avatar.bone_heads - heads - laid.place, axis=1)
    shorter = body.statures(body.train_bodies) - body.statures(laid.coefficients[None])
    alike = body.train_bodies[np.abs(shorter).argsort()[:OF_THAT_STATURE]]
    deviation = (laid.coefficients - alike.mean(axis=0)) / alike.std(axis=0)
    return Likeness(
        shape_deviation=float(np.sqrt(np.mean(deviation**2))),
        skin_distance_mm=float(1000 * np.linalg.norm(laid.missing, axis=1).mean()),
        longest_ratio=float(ratio[longest]),
        longest_bone=rig.bone_names[longest],
        pivot_distance_mm=float(1000 * apart.max()),
        pivot_bone=rig.bone_names[int(apart.argmax())],
    )


def body_overlap(avatar: Avatar, rig: Rig, poses: np.ndarray) -> float:
    """Share of the skin [%] that lies inside another part of the body, mean over joint positions (P, d) [rad]: points
    just under the skin that are inside twice, by winding number. Only a closed surface can tell."""
    from point_cloud_utils import triangle_soup_fast_winding_number

    avatar = thinned(avatar)
    chosen = slice(None, None, max(1, len(avatar.vertices) // MEASURED_POINTS))
    faces = avatar.faces.astype(np.int64)
    shares = []
    for positions in poses:
        posed = avatar.posed_vertices(rig.bone_transforms(positions, heads=avatar.bone_heads)).astype(np.float64)
        under = posed[chosen] - UNDER_SKIN * vertex_normals(posed, avatar.faces)[chosen]
        winding = triangle_soup_fast_winding_number(posed, faces, np.ascontiguousarray(under))
        shares.append(100 * (np.round(winding) >= 2).mean())
    return float(np.mean(shares))
