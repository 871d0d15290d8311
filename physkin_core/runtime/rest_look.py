"""How a garment sits at rest, seen when it is bound: by sampled skin, which unlike the exact distances of `physkin
check` never holds up other threads.

Dimensions: `n` garment vertices. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import vertex_normals
from physkin_core.runtime.skin_clearance import SkinClearance

__all__ = ["RestLook", "look_at_rest"]

INSIDE, MOST_INSIDE = 0.001, 0.5
"""A garment of which more than this share [%] is farther inside the skin at rest than this [m] does not sit."""


@dataclass(frozen=True)
class RestLook:
    """inside_percent: of the garment's vertices, more than 1 mm inside the skin. deepest_mm: the deepest of all."""

    inside_percent: float
    deepest_mm: float

    @property
    def sits(self) -> bool:
        """At most 0.5 % inside."""
        return self.inside_percent <= MOST_INSIDE

    @property
    def advice(self) -> str:
        """What to do; empty where the garment sits."""
        return "" if self.sits else "look at it, or run physkin check"

    def __str__(self) -> str:
        found = f"{self.inside_percent:.1f} % of the cloth is inside the body at rest, up to {self.deepest_mm:.0f} mm"
        return found if self.sits else f"{found}; {self.advice}"


def look_at_rest(cloth: np.ndarray, faces: np.ndarray, avatar: Avatar) -> RestLook:
    """Of cloth (n, 3) with faces (f, 3), draped at the canonical pose; some tens of milliseconds."""
    cloth = cloth.astype(np.float64)
    skin = SkinClearance(avatar.vertices, avatar.faces)
    clearance, _ = skin(cloth, vertex_normals(cloth, faces), far=np.inf)
    inside = np.flatnonzero(clearance < -INSIDE)
    clearance[inside] = skin.of_nearest(cloth[inside])  # folds face the other way, as skin across the body does
    return RestLook(
        inside_percent=float(100 * (clearance < -INSIDE).mean()),
        deepest_mm=float(1000 * max(0.0, -clearance.min())),
    )
