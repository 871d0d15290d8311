"""How cloth lies about the legs: whether it goes round both in one, as a skirt does, and whether it reaches the knees.

Dimensions: `m` garment nodes. Metres, canonical pose.
"""

from __future__ import annotations

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.rig.rig import Rig

__all__ = ["goes_round_both_legs", "of_legs", "reaches_knees", "thighs"]

LOOKED_AT = 0.75
"""Share of the garment's depth below the hips, at which it is looked whether it goes round both legs."""


def thighs(rig: Rig) -> list[int]:
    """The bones from the hips down, one a leg; none of a rig without legs."""
    return [k for k, name in enumerate(rig.bone_names) if name.startswith("upperleg01")]


def reaches_knees(rig: Rig, node_bone: np.ndarray) -> bool:
    """Whether a garment node follows a lower leg: node_bone (m,), the bone of `rig` that each follows."""
    return any(rig.bone_names[bone].startswith("lowerleg") for bone in set(node_bone.tolist()))


def goes_round_both_legs(garment: Garment, rig: Rig, node_rest: np.ndarray, node_bone: np.ndarray) -> bool:
    """From the garment's mesh and the bones that it follows, not from its name: False, too, where the rig has no legs.

    node_rest: (m, 3) on the garment, node_bone: (m,) the bone of `rig` that each garment node follows.
    """
    hips = thighs(rig)
    if not hips:
        return False
    middle, hip = rig.heads[hips].mean(axis=0), rig.heads[hips, 2].min()
    lowest = garment.vertices[:, 2].min()
    level = hip + LOOKED_AT * (lowest - hip)
    if lowest >= hip or abs(_winding(garment, level, middle[:2])) < 0.5:
        return False
    return bool((of_legs(rig)[node_bone] & (node_rest[:, 2] < hip)).any())  # a sleeve may hang as low


def _winding(garment: Garment, level: float, axis: np.ndarray) -> float:
    """How often the garment's outline at a height goes round a vertical axis (2,): 1 or -1 where it is closed."""
    corners = garment.vertices[garment.faces].astype(np.float64)
    above = corners[:, :, 2] > level
    ends = []
    for rising in (True, False):  # where the boundary of each face goes up through the level, and down
        edges = [(above[:, (k + 1) % 3] != above[:, k]) & (above[:, (k + 1) % 3] == rising) for k in range(3)]
        crossed = np.stack(edges, axis=1)
        cut = crossed.any(axis=1)
        start = crossed[cut].argmax(axis=1)
        a = np.take_along_axis(corners[cut], start[:, None, None], axis=1)[:, 0]
        b = np.take_along_axis(corners[cut], (start[:, None, None] + 1) % 3, axis=1)[:, 0]
        at = a + (b - a) * ((level - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
        ends.append((at[:, :2] - axis) @ [1, 1j])
    return float(np.angle(ends[1] * ends[0].conj()).sum() / (2 * np.pi))


def of_legs(rig: Rig) -> np.ndarray:
    """(b,) whether a bone is between the root and a hip, or of a leg."""
    hips = thighs(rig)
    wanted = rig.inherited(dict.fromkeys(hips, 1), 0).astype(bool)
    wanted[[above for hip in hips for above in rig.ancestors(hip)]] = True
    return wanted
