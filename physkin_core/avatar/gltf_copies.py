"""Meshes of a glTF file that draw the same figure again: its coarser levels of detail, and shells around it.

Dimensions: `V` vertices, `f` faces.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from physkin_core.avatar.skinned_mesh import clean_surface
from physkin_core.file_reading import listed
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_scene import Drawn
from physkin_core.model.surface_paths import mesh_edges
from physkin_core.quality import closest_points

__all__ = ["coarse_copies"]

LEVEL = re.compile(r"lod[ _.-]?(\d+)", re.IGNORECASE)
SAME_BOX, SAME_SURFACE = 0.02, 0.004
"""Shares of the extent: by how much the boxes about two meshes differ, and how far the vertices of the coarser one lie
from the finer one on average, where both are one surface."""
PIECES = 0.5
"""Share of edges that one face alone has, from which on meshes may be pieces that fill each other up."""


def coarse_copies(file: GltfFile, drawn: Sequence[Drawn]) -> tuple[set[int], list[str]]:
    """Nodes whose meshes draw what another one draws finer, and a warning where there are any: by names with `LOD1`, by
    the extension MSFT_lod, or by place and shape."""
    by_node: dict[int, list[Drawn]] = {}
    for each in drawn:
        by_node.setdefault(each.node, []).append(each)
    coarse = {
        other for node in file.nodes for other in node.entry("extensions").entry("MSFT_lod").indices("ids")
    } & by_node.keys()
    names = {node: _levelled_name(file, each[0]) for node, each in by_node.items()}
    levels = {node: int(match[1]) for node, name in names.items() if (match := LEVEL.search(name))}
    finest: dict[str, int] = {}
    for node, level in levels.items():
        plain = LEVEL.sub("", names[node])
        finest[plain] = min(level, finest.get(plain, level))
    coarse |= {node for node, level in levels.items() if level > finest[LEVEL.sub("", names[node])]}
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    finer_first = sorted(by_node, key=lambda node: -sum(len(each.faces) for each in by_node[node]))
    for node in finer_first:
        if node in coarse or file.nodes[node].index("skin") is None:
            continue
        surface = _surface(by_node[node])
        if any(_repeats(surface, other) for other in kept):
            coarse.add(node)
        else:
            kept.append(surface)
    if not coarse:
        return coarse, []
    called = listed([file.nodes[node].text("name") or f"node {node}" for node in sorted(coarse)])
    return coarse, [f"these meshes draw again what others draw finer: {called}; left out"]


def _levelled_name(file: GltfFile, drawn: Drawn) -> str:
    """The node's name, or the mesh's where only that has a level of detail."""
    names = file.nodes[drawn.node].text("name"), drawn.mesh.text("name")
    return next(filter(LEVEL.search, names), names[0])


def _surface(drawn: Sequence[Drawn]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) in mesh space and faces (f, 3) of a node's mesh."""
    starts = np.cumsum([0, *(len(each.positions) for each in drawn)])
    faces = np.concatenate([each.faces + start for each, start in zip(drawn, starts)])
    return np.concatenate([each.positions for each in drawn]), faces


def _repeats(surface: tuple[np.ndarray, np.ndarray], finer: tuple[np.ndarray, np.ndarray]) -> bool:
    boxes = [np.stack([vertices.min(axis=0), vertices.max(axis=0)]) for vertices, _ in (surface, finer)]
    extent = np.ptp(boxes[1], axis=0).max()
    if not np.abs(boxes[0] - boxes[1]).max() < SAME_BOX * extent:
        return False
    there, back = closest_points(surface[0], *finer)[0], closest_points(finer[0], *surface)[0]
    if max(there.mean(), back.mean()) > SAME_SURFACE * extent:
        return False
    return max(map(_open_share, (surface, finer))) < PIECES


def _open_share(surface: tuple[np.ndarray, np.ndarray]) -> float:
    """Share of the edges that one face alone has."""
    _, faces, _, _ = clean_surface(*surface, (), "")
    return float((mesh_edges(faces)[1] == 1).mean())
