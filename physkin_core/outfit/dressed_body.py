"""A body as the next layer of an outfit finds it: its skin, moved outwards by what is already worn.

Training swells bodies by at most 15 mm, smoothly from part to part, so that a garment knows what it is to be worn over
another. Here the swelling is measured: how far the layers at rest lie off the skin, and a gap.

Dimensions: `V` body vertices, `n` garment vertices. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import vertex_normals

__all__ = ["LARGEST_SWELLING", "LAYER_GAP", "WornLayer", "dressed_body"]

LAYER_GAP = 0.002
"""[m] between one layer and the next."""
LARGEST_SWELLING = 0.015
"""[m] What training knows; cloth that hangs farther from the skin swells it by no more."""
BESIDE = 0.015
"""[m] Skin whose closest cloth is farther to the side than this lies beyond a hem."""
RADIUS = 0.03
"""[m] Length over which the swelling is smoothed along the skin."""
NEIGHBOURS = 64
OPPOSITE = 0.15
"""[m] off the skin from where cloth is that of another part of the body."""
TUCKED = 0.005
"""[m] What a tucked layer swells the skin by, which it hugs where the next one lies over it."""


@dataclass(frozen=True)
class WornLayer:
    """What is already worn: vertices and normals (n, 6) at the canonical pose, faces (f, 3). tucked: under the next."""

    cloth: np.ndarray
    faces: np.ndarray
    tucked: bool = False


def dressed_body(avatar: Avatar, layers: Sequence[WornLayer]) -> Avatar:
    """The avatar with its skin moved outwards to 2 mm over the layers it wears, by at most 15 mm, smoothly.

    Bones and skinning weights stay. The same avatar where there are no layers.
    """
    from scipy.spatial import cKDTree

    if not layers:
        return avatar
    skin = avatar.vertices.astype(np.float64)
    outward = vertex_normals(skin, avatar.faces)
    tagged = with_normals(skin, outward)
    swelling = np.zeros(len(skin))
    for layer in layers:
        points, normals = layer.cloth[:, :3].astype(np.float64), layer.cloth[:, 3:].astype(np.float64)
        gap = points[cKDTree(with_normals(points, normals)).query(tagged)[1]] - skin
        height = np.einsum("vi,vi->v", gap, outward)
        aside = np.linalg.norm(gap - height[:, None] * outward, axis=1)
        wanted = np.clip(height + LAYER_GAP, 0, TUCKED if layer.tucked else LARGEST_SWELLING)
        swelling = np.maximum(swelling, np.where((aside < BESIDE) & (height < OPPOSITE), wanted, 0))
    distance, near = cKDTree(tagged).query(tagged, k=min(NEIGHBOURS, len(skin)))
    share = np.exp(-((distance / RADIUS) ** 2))
    smooth = (share * swelling[near]).sum(axis=1) / share.sum(axis=1)
    return replace(avatar, vertices=(skin + smooth[:, None] * outward).astype(np.float32))
