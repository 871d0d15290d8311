"""Which bones are those of the legs, and whether cloth reaches the knees.

Dimensions: `b` bones, `m` garment nodes.
"""

from __future__ import annotations

import numpy as np

from physkin_core.rig.rig import Rig

__all__ = ["of_legs", "reaches_knees", "thighs"]


def thighs(rig: Rig) -> list[int]:
    """The bones from the hips down, one a leg; none of a rig without legs."""
    return [k for k, name in enumerate(rig.bone_names) if name.startswith("upperleg01")]


def reaches_knees(rig: Rig, node_bone: np.ndarray) -> bool:
    """Whether a garment node follows a lower leg: node_bone (m,), the bone of `rig` that each follows."""
    return any(rig.bone_names[bone].startswith("lowerleg") for bone in set(node_bone.tolist()))


def of_legs(rig: Rig) -> np.ndarray:
    """(b,) whether a bone is between the root and a hip, or of a leg."""
    hips = thighs(rig)
    wanted = rig.inherited(dict.fromkeys(hips, 1), 0).astype(bool)
    wanted[[above for hip in hips for above in rig.ancestors(hip)]] = True
    return wanted
