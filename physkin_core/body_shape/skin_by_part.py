"""The skin of a body by the part that it belongs to, and its trunk as a smooth surface.

Dimensions: `V` skin points. Metres, canonical pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.body_shape.limb_chains import Limbs
from physkin_core.body_shape.radial_shape import RadialShape, fit_radial_shape
from physkin_core.model.garment import face_areas
from physkin_core.rig.linear_blend_skinning import dense_weights
from physkin_core.rig.rig import Rig

__all__ = ["SkinByPart", "SkinPoints", "trunk_of"]

ABOVE_CROTCH = 0.01
"""[m] The trunk's surface begins here; legs are below."""
MOST_BELOW_HIPS = 0.2
"""[m] The crotch is not farther below the hip joints."""
MIDDLE = 0.03
"""[m] The crotch is looked for in skin this near to the plane of symmetry."""
SHORTEST_TRUNK = 0.1


@dataclass(frozen=True)
class SkinPoints:
    """Skin of a part of the body: points (V, 3), and areas (V,) that they stand for [m2]."""

    points: np.ndarray
    areas: np.ndarray


class SkinByPart:
    """Skin points by the part of the body they belong to: three of each limb, then the head, else the trunk."""

    def __init__(self, avatar: Avatar, rig: Rig, found: Limbs) -> None:
        self.limbs = len(found.limbs)
        starts = {bone: 3 * k + part for k, limb in enumerate(found.limbs) for part, bone in enumerate(limb.ends)}
        if found.head >= 0:
            starts[found.head] = 3 * self.limbs
        parts = rig.inherited(starts, 3 * self.limbs + 1)[avatar.influence_bones]
        self._part = dense_weights(parts, avatar.influence_weights, 3 * self.limbs + 2).argmax(axis=1)
        self._points = avatar.vertices.astype(np.float64)
        corners = np.repeat(face_areas(self._points, avatar.faces) / 3, 3)
        self._areas = np.bincount(avatar.faces.reshape(-1), corners, len(self._points))

    def of(self, *parts: int) -> SkinPoints:
        """Points of parts, those that faces use."""
        chosen = np.isin(self._part, parts) & (self._areas > 0)
        return SkinPoints(self._points[chosen], self._areas[chosen])

    def head(self) -> SkinPoints:
        """Of the head."""
        return self.of(3 * self.limbs)

    def trunk(self, *more: int) -> SkinPoints:
        """Of the trunk, and of more parts."""
        return self.of(3 * self.limbs + 1, *more)


def trunk_of(skin: SkinByPart, found: Limbs, heads: np.ndarray) -> RadialShape:
    """The surface from crotch to shoulders, thighs above the crotch included. Raises ValueError where that is too
    short."""
    own = skin.trunk()
    shoulders = [heads[limb.ends[0], 2] for limb in found.limbs if limb.is_arm]
    hips = [heads[limb.ends[0]] for limb in found.limbs if not limb.is_arm]
    high = float(np.mean(shoulders)) if shoulders else float(np.quantile(own.points[:, 2], 0.9))
    middle = np.average(own.points, axis=0, weights=own.areas)
    inner = np.abs(own.points[:, 1] - middle[1]) < MIDDLE
    crotch = own.points[inner, 2].min() if inner.any() else own.points[:, 2].min()
    if hips:  # not a tail's or a coat's
        crotch = max(crotch, np.mean(hips, axis=0)[2] - MOST_BELOW_HIPS)
    low = float(crotch) + ABOVE_CROTCH
    if high - low < SHORTEST_TRUNK:
        raise ValueError(
            f"limbs cannot be separated: the trunk is {high - low:.2f} m high between crotch and shoulders"
        )
    thighs = [3 * k for k, limb in enumerate(found.limbs) if not limb.is_arm]
    points = skin.trunk(*thighs)
    between = (points.points[:, 2] > low) & (points.points[:, 2] < high)
    return fit_radial_shape(points.points[between], points.areas[between], low, high)
