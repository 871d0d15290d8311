"""Meshes of a glTF file that draw the same figure again: coarser levels of detail, and shells around it.

Dimensions: `V` vertices, `f` faces.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from physkin_core.avatar.skinned_mesh import Surface, clean_surface
from physkin_core.formats.gltf_scene import Drawn
from physkin_core.model.surface_paths import mesh_edges
from physkin_core.quality import closest_points

__all__ = ["coarse_copies"]

SAME_BOX, SAME_SURFACE = 0.02, 0.005
"""Shares of the extent: by how much the boxes about two meshes differ, and how far the vertices of each lie from the
other on average, where both are one surface."""
LEVEL = re.compile(r"[ _.-]*lod[ _.-]*\d+", re.IGNORECASE)
"""What names of levels of detail have beside that of the figure."""
PIECES = 0.5
"""Share of edges that one face alone has, from which on meshes may be pieces that fill each other up."""


def coarse_copies(drawn: Sequence[Drawn], names: Sequence[str]) -> set[int]:
    """Nodes whose meshes draw what another node's draws with more faces: by shape, or by the names of nodes."""
    by_node: dict[int, list[Drawn]] = {}
    for each in drawn:
        by_node.setdefault(each.node, []).append(each)
    coarse, kept, called = set(), [], set()
    for node, parts in sorted(by_node.items(), key=lambda item: -sum(len(each.faces) for each in item[1])):
        starts = np.cumsum([0, *(len(each.positions) for each in parts)])
        faces = np.concatenate([each.faces + start for each, start in zip(parts, starts)])
        surface = np.concatenate([each.positions for each in parts]), faces
        name = LEVEL.sub("", names[node])
        if (name in called and name != names[node]) or any(_repeats(surface, finer) for finer in kept):
            coarse.add(node)
        else:
            kept.append(surface)
            called.add(name)
    return coarse


def _repeats(surface: tuple[np.ndarray, np.ndarray], finer: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether vertices (V, 3) and faces (f, 3) are about the same surface, and each is whole."""
    boxes = [np.stack([vertices.min(axis=0), vertices.max(axis=0)]) for vertices, _ in (surface, finer)]
    extent = np.ptp(boxes[1], axis=0).max()
    if not np.abs(boxes[0] - boxes[1]).max() < SAME_BOX * extent:
        return False
    apart = [closest_points(one[0], *other)[0].mean() for one, other in ((surface, finer), (finer, surface))]
    return max(apart) < SAME_SURFACE * extent and max(map(_open_share, (surface, finer))) < PIECES


def _open_share(surface: tuple[np.ndarray, np.ndarray]) -> float:
    return float((mesh_edges(clean_surface(Surface(*surface), (), "")[0].faces)[1] == 1).mean())
