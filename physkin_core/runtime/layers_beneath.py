"""What a garment is worn over: how far layers beneath it lift it off the skin.

Training swells bodies by at most 15 mm, smoothly from part to part, so that a garment knows what it is to be worn over
another. Here the swelling is measured: how far what is worn already lies off the skin at rest, and a gap.

Dimensions: `V` body vertices, `n` garment vertices. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import vertex_normals
from physkin_core.runtime.layer import Layer

__all__ = ["LARGEST_SWELLING", "LAYER_GAP", "swelling"]

LAYER_GAP = 0.002
"""[m] between one layer and the next."""
LARGEST_SWELLING = 0.015
"""[m] What training knows; cloth that hangs farther from the skin swells it by no more."""
TUCKED_SWELLING = 0.005
"""[m] A tucked layer hugs the skin where the next one lies over it."""
BESIDE = 0.015
"""[m] Skin whose closest cloth is farther to the side than this lies beyond a hem."""
OPPOSITE = 0.15
"""[m] off the skin from where cloth is that of another part of the body."""
RADIUS = 0.045
"""[m] Length over which the swelling is smoothed along the skin."""
NEIGHBOURS = 128


def swelling(skin: np.ndarray, faces: np.ndarray, beneath: Sequence[Layer]) -> np.ndarray:
    """Displacement (V, 3) [m] of skin (V, 3) with faces (f, 3), outwards to 2 mm over the layers it wears: at most
    15 mm, smooth along the skin."""
    from scipy.spatial import cKDTree

    outward = vertex_normals(skin, faces)
    tagged = with_normals(skin, outward)
    height = np.zeros(len(skin))
    for layer in beneath:
        points = layer.rest.astype(np.float64)
        gap = points[cKDTree(with_normals(points[:, :3], points[:, 3:])).query(tagged)[1], :3] - skin
        off = np.einsum("vi,vi->v", gap, outward)
        aside = np.linalg.norm(gap - off[:, None] * outward, axis=1)
        lifted = np.clip(off + LAYER_GAP, 0, TUCKED_SWELLING if layer.tucked else LARGEST_SWELLING)
        height = np.maximum(height, np.where((aside < BESIDE) & (off < OPPOSITE), lifted, 0))
    distance, near = cKDTree(tagged).query(tagged, k=min(NEIGHBOURS, len(skin)))
    share = np.exp(-((distance / RADIUS) ** 2))
    return ((share * height[near]).sum(axis=1) / share.sum(axis=1))[:, None] * outward
