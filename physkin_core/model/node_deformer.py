"""Node deformer: posed garment nodes -> per-node corrective, modulated by the pose modulator (paper: Node Deformer).

Its first layer sees 12 numbers a garment node, but a posed node is a linear function of the one bone it follows: for a
given body the layer folds, exactly, into one over the bones that the garment uses (`fold_first_layer`).
"""

from __future__ import annotations

import numpy as np

from physkin_core.rig.rig import Rig

__all__ = ["fold_first_layer"]


def fold_first_layer(
    weight: np.ndarray,
    node_bone: np.ndarray,
    node_positions: np.ndarray,
    *,
    rig: Rig | None = None,
    elsewhere: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Fold the first layer onto bone transforms.

    weight: (h, 12 m) over row-major (3, 4) node transforms. node_bone: (m,). node_positions: (m, 3) on the body that
    the layer is to see. rig, elsewhere: for transforms of another body with the same rotations, the rig and the (b, 3)
    [m] by which the seen body's bone heads are elsewhere than that body's.
    Returns the bones used (u,) int32 and the weight (h, 12 u) over their row-major (3, 4) transforms.
    """
    used, slot = np.unique(node_bone, return_inverse=True)
    per_node = weight.reshape(len(weight), -1, 3, 4).astype(np.float64)
    # chi_skin = [R | R q + t]: the translation column feeds the rotation through q, the bone's as it is.
    rotation = per_node[..., :3] + per_node[..., 3:] * node_positions[None, :, None, :]
    folded = np.zeros((len(weight), len(used), 3, 4))
    np.add.at(folded, (slice(None), slot), np.concatenate([rotation, per_node[..., 3:]], axis=-1))
    if rig is not None:
        through = rig.translation_change(elsewhere)[used]  # t of the seen body = t + sum over bones of R_b through_b
        for bone in np.flatnonzero(through.any(axis=(0, 2))):
            alike = np.flatnonzero(rig.turns_with[used] == rig.turns_with[bone])
            if len(alike) == 0:
                used, alike = np.append(used, bone), [len(used)]
                folded = np.concatenate([folded, np.zeros((len(weight), 1, 3, 4))], axis=1)
            moved = np.einsum("hui,uj->hij", folded[:, : len(through), :, 3], through[:, bone])
            folded[:, alike[0], :, :3] += moved
    return used.astype(np.int32), folded.reshape(len(weight), -1)
