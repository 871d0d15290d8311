"""Boundaries of a mesh that run along each other, as panels that are not quite joined have them: found, and sewn.

Dimensions: `n` vertices, `f` faces, `b` boundary edges, `p` pairs of a vertex and an edge. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from trimesh.geometry import faces_to_edges
from trimesh.graph import connected_component_labels

from physkin_core.model.skinning import unit

__all__ = ["SEAM", "Runs", "find_runs", "sewn_along"]

SHORTEST = 0.03
"""[m] Boundaries that are near each other for less than this are the ends of darts and slits."""
NARROWEST = 1e-3
"""[m] No strap of cloth is so narrow: what is nearer overlaps."""
SEAM = 0.003
"""[m] Boundaries this near are joined, however pieces lie."""
TOUCHING = 1e-4
"""[m] What is nearer than this is joined whatever its length."""
FRONT_ASIDE = 0.05
"""[m] from the middle. One nearer that opens forward from the uppermost rim is an open front, and stays open."""
SNAP = 0.3
"""A vertex is joined to the end of an edge within this share of the edges here, else to a new vertex on the edge."""


@dataclass(frozen=True)
class Runs:
    """Boundary vertices (p,) near boundary edges (p, 2), the gaps (p,) [m] between them, and where on the edges they
    are, at (p,) from 0 to 1. snap: (p,) as `SNAP`, likewise. apart: (p,) whether they are of separate pieces. length:
    [m] of seam that they make. open_front: whether others are left out, along an open front."""

    vertex: np.ndarray
    edge: np.ndarray
    at: np.ndarray
    gap: np.ndarray
    snap: np.ndarray
    apart: np.ndarray
    length: float
    open_front: bool


def find_runs(vertices: np.ndarray, faces: np.ndarray, within: float) -> Runs:
    """Boundaries of vertices (n, 3) and faces (f, 3) with at most a gap `within` between their cloth, which goes on
    beyond it."""
    sides, owner = faces_to_edges(faces, return_index=True)
    _, number, count = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True)
    alone = count[number.reshape(-1)] == 1
    rim, third = sides[alone], faces[owner[alone]].sum(axis=1) - sides[alone].sum(axis=1)
    start, along = vertices[rim[:, 0]], vertices[rim[:, 1]] - vertices[rim[:, 0]]
    length = np.linalg.norm(along, axis=1)
    inward = unit(np.cross(np.cross(along, vertices[third] - start), along))
    own, shortest, least = np.zeros_like(vertices), *np.full((2, len(vertices)), np.inf)
    np.add.at(own, rim, inward[:, None])
    np.minimum.at(shortest, rim, length[:, None])
    own = unit(own)
    spacing = length.mean() if len(rim) else 0.0
    parts = np.ceil(length / max(spacing, 1e-9)).astype(int)
    edge = np.repeat(np.arange(len(rim)), parts)
    share = (np.arange(len(edge)) - np.repeat(parts.cumsum() - parts, parts) + 0.5) / parts[edge]
    points, samples = np.unique(rim), start[edge] + share[:, None] * along[edge]
    near = [cKDTree(samples).query_ball_point(vertices[points], within + spacing / 2)] if len(rim) else []
    pairs = [(point, edge[sample]) for each in near for point, found in zip(points, each) for sample in found]
    vertex, edge = np.unique(np.reshape(pairs, (-1, 2)).astype(int), axis=0).T
    at = np.clip(((vertices[vertex] - start[edge]) * along[edge]).sum(axis=1) / length[edge] ** 2, 0, 1)
    across = start[edge] + at[:, None] * along[edge] - vertices[vertex]
    gap = np.linalg.norm(across, axis=1)
    piece = connected_component_labels(sides, node_count=len(vertices))
    apart = piece[vertex] != piece[rim[edge, 0]]
    beyond = ((across * own[vertex]).sum(axis=1) <= -gap / 2) | (gap < np.where(apart, SEAM, NARROWEST))
    kept = (gap <= within) & beyond & ((own[vertex] * inward[edge]).sum(axis=1) < 0.5)
    kept &= (rim[edge] != vertex[:, None]).all(axis=1)
    np.minimum.at(least, vertex[kept], gap[kept])
    kept &= gap <= 2 * least[vertex] + TOUCHING
    beside = np.isin(rim, [*vertex[kept], *np.flatnonzero(np.bincount(rim.ravel()) > 2)]).all(axis=1)
    label = connected_component_labels(rim[beside], node_count=len(vertices))
    long = np.bincount(label[rim[beside, 0]], length[beside], len(vertices)) >= SHORTEST
    kept &= long[label[vertex]] | (gap <= TOUCHING)
    front = np.zeros(len(gap), bool)
    front[kept] = _along_front(vertices, rim, label, *(each[kept] for each in (vertex, gap, apart)))
    kept &= ~front
    beside &= ~np.isin(rim, vertex[front]).all(axis=1)
    snap = SNAP * np.minimum(1.0, shortest[vertex] / length[edge])
    made = float(length[beside][long[label[rim[beside, 0]]]].sum() / 2)
    return Runs(*(each[kept] for each in (vertex, rim[edge], at, gap, snap, apart)), made, bool(front.any()))


def _along_front(
    vertices: np.ndarray, rim: np.ndarray, chain: np.ndarray, vertex: np.ndarray, gap: np.ndarray, apart: np.ndarray
) -> np.ndarray:
    """Which pairs (p,) are of chains along an open front. Those of a seam lie elsewhere, nearer than `TOUCHING`, or
    between pieces that it has to join. rim: (b, 2); chain: (n,) number of each vertex's."""
    loop, chain = connected_component_labels(rim, node_count=len(vertices)), chain[vertex]
    at_front = loop[vertex] == (loop[rim[vertices[rim[:, 0], 2].argmax(), 0]] if len(rim) else -1)
    forward, aside = vertices[vertex, 0] - vertices[:, 0].mean(), vertices[vertex, 1]
    count = np.maximum(np.bincount(chain), 1)
    apart, gap, forward, aside = ((np.bincount(chain, each) / count)[chain] for each in (apart, gap, forward, aside))
    return at_front & (apart == 0) & (gap > TOUCHING) & (forward > 0) & (np.abs(aside) < FRONT_ASIDE)


def sewn_along(vertices: np.ndarray, faces: np.ndarray, runs: Runs) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with one boundary vertex, in their middle, for those across a gap; edges are divided where there is no
    vertex on the other side."""
    ends = np.where(runs.at < 0.5, runs.edge[:, 0], runs.edge[:, 1])
    inside = np.minimum(runs.at, 1 - runs.at) > runs.snap
    start, end = vertices[runs.edge[inside]].swapaxes(0, 1)
    ends[inside] = len(vertices) + np.arange(inside.sum())
    vertices = np.concatenate([vertices, start + runs.at[inside, None] * (end - start)])
    for one, other in np.unique(runs.edge[inside], axis=0):
        on_edge = np.flatnonzero(inside & (runs.edge == [one, other]).all(axis=1))
        chain = np.array([one, *ends[on_edge[np.argsort(runs.at[on_edge])]], other])
        face = int(((faces == one).any(axis=1) & (faces == other).any(axis=1)).argmax())
        corner = np.full(len(chain) - 1, faces[face].sum() - one - other)
        faces = np.concatenate([np.delete(faces, face, axis=0), np.column_stack([chain[:-1], chain[1:], corner])])
    label = connected_component_labels(np.column_stack([runs.vertex, ends]), node_count=len(vertices))
    middle = np.stack([np.bincount(label, axis) for axis in vertices.T], axis=1) / np.bincount(label)[:, None]
    faces = label[faces]
    return middle, faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
