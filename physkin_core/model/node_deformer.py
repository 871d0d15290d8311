"""Node deformer: posed garment nodes -> per-node corrective, modulated by the pose modulator (paper: Node Deformer).

Its first layer sees 12 numbers a garment node, but a posed node is a linear function of the one bone it follows: for a
given body the layer folds, exactly, into one over the bones that the garment uses (`fold_first_layer`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.model.mlp import Layer, modulated_mlp

__all__ = ["fold_first_layer", "node_corrections"]


def node_corrections(
    layers: Sequence[Layer], transforms: np.ndarray, modulation: np.ndarray, activation: str
) -> np.ndarray:
    """Raw numbers of delta-chi (see `garment_nodes.delta_transforms`).

    transforms: (..., m, 3, 4) chi_skin; (..., u, 3, 4) of the bones used when the first layer is folded onto them.
    modulation: from `pose_modulation`. Returns (..., 9 m) or (..., 12 m).
    """
    return modulated_mlp(layers, transforms.reshape(*transforms.shape[:-3], -1), modulation, activation)


def fold_first_layer(
    weight: np.ndarray, node_bone: np.ndarray, node_positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fold the first layer onto bone transforms.

    weight: (h, 12 m) over row-major (3, 4) node transforms. node_bone: (m,). node_positions: (m, 3) on this body.
    Returns the bones used (u,) int32 and the weight (h, 12 u) over their row-major (3, 4) transforms.
    """
    used, slot = np.unique(node_bone, return_inverse=True)
    per_node = weight.reshape(len(weight), -1, 3, 4).astype(np.float64)
    # chi_skin = [R | R q + t]: the translation column feeds the rotation through q, the bone's as it is.
    rotation = per_node[..., :3] + per_node[..., 3:] * node_positions[None, :, None, :]
    folded = np.zeros((len(weight), len(used), 3, 4))
    np.add.at(folded, (slice(None), slot), np.concatenate([rotation, per_node[..., 3:]], axis=-1))
    return used.astype(np.int32), folded.reshape(len(weight), -1)
