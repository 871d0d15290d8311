"""Pose modulator: pose vector -> modulation of the node deformer; itself modulated by the body (paper: same name)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.model.mlp import Layer, modulated_mlp

__all__ = ["pose_modulation"]


def pose_modulation(layers: Sequence[Layer], pose_vector: np.ndarray, body_modulation: np.ndarray | None) -> np.ndarray:
    """Scale and shift for every hidden unit of the node deformer.

    pose_vector: (..., p) from `Rig.pose_vector`. body_modulation: (..., s) from the hyper modulator; None for layers
    into which it is folded (`physkin_core.model.mlp.fold_modulation`).
    Returns (..., 2 * sum of the node deformer's hidden widths), laid out as in `physkin_core.model.mlp`.
    """
    return modulated_mlp(layers, pose_vector, body_modulation)
