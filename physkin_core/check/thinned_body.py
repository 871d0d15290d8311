"""A body of many triangles with fewer of them, on which figures over many poses take a tenth of the time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.rig.linear_blend_skinning import strongest_influence

__all__ = ["thinned"]

MANY_FACES = 100_000
"""Bodies with no more faces are left as they are."""
CELL = 0.008
"""[m] Of the vertices in a cell of this size one remains, which moves skin as round as an arm by 0.2 mm at most."""


def thinned(avatar: Avatar) -> Avatar:
    """The body with one vertex for each small cell and bone, where it has many faces; itself elsewhere.

    What remains is where it was, and a closed surface stays closed.
    """
    if len(avatar.faces) <= MANY_FACES:
        return avatar
    vertices = avatar.vertices.astype(np.float64)
    cells = np.floor((vertices - vertices.min(axis=0)) / CELL).astype(np.int64)
    keys = np.column_stack([cells, strongest_influence(avatar.influence_bones, avatar.influence_weights)])
    group = np.unique(np.ravel_multi_index(keys.T, keys.max(axis=0) + 1), return_inverse=True)[1]
    middle = np.stack([np.bincount(group, axis) for axis in vertices.T], axis=1) / np.bincount(group)[:, None]
    order = np.lexsort([np.linalg.norm(vertices - middle[group], axis=1), group])
    kept = order[np.unique(group[order], return_index=True)[1]]  # the closest to the middle of each
    faces = group[avatar.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return replace(
        avatar,
        vertices=avatar.vertices[kept],
        faces=faces.astype(np.int32),
        influence_bones=avatar.influence_bones[kept],
        influence_weights=avatar.influence_weights[kept],
        file_vertices=None,
        file_corners=None,
        accessories=None,
        clothes=(),
    )
