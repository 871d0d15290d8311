"""The order of two layers in every frame. Vertices of the outer layer that would be inside the inner one are moved out
of it; vertices of a tucked layer that would be outside the waistband over it are moved inside.

One layer is steady, the other yields. Every vertex that may touch the steady layer has a partner there, its closest
vertex. The search for it begins at the vertices that it meets in everyday poses, at the last frame's partner and at the
partners of contacts around it, and walks along the mesh from there. The planes around the partner, weighted by how near
they are along the cloth, say how far the vertex is on the right side; that changes continuously with the pose. A vertex
that is not far enough is pushed along its own normal, and the vertices around it less and less, so that no hem flares
and no spike stands out. Along the steady layer it may slide.

Cloth that is turned inside out, as a lapel is, has the cloth that it lies on for its place in the order: nothing is
kept off it, and it goes where that is pushed.

native/src/outfit/layer_order.cpp does that on every frame; here it is found out once where two layers may touch.

Dimensions: `n` vertices of the yielding layer, `r` of the steady one, `s` contacts, `u` vertices that may be moved.
Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.surface_paths import mesh_edges
from physkin_core.native_module import native

__all__ = ["TURNS", "LayerOrder", "bind_layer_order"]

DEEPEST: float = native.constants["deepest"]
"""[m] A vertex farther on the wrong side is of another part of the body."""
TURNS: int = native.constants["turns"]
"""Frames in which every vertex has its turn to look for a closer partner; one that lost its own does at once."""
BESIDE_COUNT: int = native.constants["beside"]
"""Contacts around, by whose partners one finds a closer partner of its own."""
SEEDS_APART, MOST_SEEDS = 3.0, 4
"""In mean edge lengths: what a contact meets in everyday poses is remembered no more densely; and how many of it."""
RADIUS = 0.04
"""[m] along the cloth over which a push is spread."""
TOUCHING, BESIDE, DILATED = 0.012, 0.02, 0.010
"""[m] Contacts come this near in everyday poses, with a partner this near to the side; and vertices this near them."""


@dataclass(frozen=True)
class LayerOrder:
    """Two layers of an outfit, of the vertices that are computed. Index arrays are int32.

    steady, yielding: which layers; the one that yields goes outwards if it is the outer one, or else inwards.
    contact: (s,) vertices of the yielding layer. seed_start: (s + 1,) into seed, the steady vertices that a contact
    may meet, first the one at rest. beside: (s, 3) indices of contacts around each. ring_start: (r + 1,) into ring,
    the neighbours of each steady vertex.
    push_start: (s + 1,) into push_to (indices into `moved`) and push_share (float32, 1 for the contact itself; below 0
    for turned cloth, which goes against its normal): what moves along with a contact. moved: (u,) yielding vertices,
    in order of index, all contacts among them. edge: [m] mean edge length of the steady layer.
    """

    steady: int
    yielding: int
    contact: np.ndarray
    seed_start: np.ndarray
    seed: np.ndarray
    beside: np.ndarray
    ring_start: np.ndarray
    ring: np.ndarray
    push_start: np.ndarray
    push_to: np.ndarray
    push_share: np.ndarray
    moved: np.ndarray
    edge: float


def _side(steady: int, yielding: int) -> int:
    return 1 if yielding > steady else -1


def _off_plane(points: np.ndarray, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (...) [m] of points (..., 3) from planes (..., 6), and the square of the distance along them."""
    gap = points - planes[..., :3]
    off = (gap * planes[..., 3:]).sum(axis=-1)
    return off, (gap * gap).sum(axis=-1) - off * off


def bind_layer_order(
    steady: int,
    yielding: int,
    rest: Sequence[np.ndarray],
    faces: Sequence[np.ndarray],
    poses: Sequence[Sequence[np.ndarray]],
    *,
    turned: Sequence[np.ndarray] | None = None,
) -> LayerOrder | None:
    """Find where two layers may touch; None where they never do.

    steady, yielding: which layers. rest: their vertices (r, 3) and (n, 3) [m] at rest, of those that are computed;
    faces: (f, 3) of these. poses: (r, 6) and (n, 6) vertices and unit normals in the poses to look at, the first at
    rest. turned: (r,) and (n,) bool, vertices of cloth that is turned inside out; None for none.
    """
    from scipy.spatial import cKDTree

    touches, matches = np.zeros(len(rest[1]), dtype=bool), []
    side = _side(steady, yielding)
    still, loose = turned or [np.zeros(len(vertices), dtype=bool) for vertices in rest]
    met = np.flatnonzero(~still)
    for stays, moves in poses:
        tree = cKDTree(with_normals(stays[met, :3], stays[met, 3:]))
        match = met[tree.query(with_normals(moves[:, :3], moves[:, 3:]))[1]]
        off, aside = _off_plane(moves[:, :3].astype(np.float64), stays[match].astype(np.float64))
        touches |= (side * off < TOUCHING) & (side * off > -DEEPEST) & (aside < BESIDE**2)
        matches.append(match)
    touches &= ~loose
    if not touches.any():
        return None
    graph, _ = _edge_graph(rest[1], faces[1])
    near = _paths(graph, np.flatnonzero(touches), DILATED)
    contact = np.flatnonzero((touches | np.isfinite(near).any(axis=0)) & ~loose)
    distance = _paths(graph, contact, RADIUS)
    outside, inside_out = np.flatnonzero(~loose), np.flatnonzero(loose)
    distance[:, inside_out] = distance[:, outside[cKDTree(rest[1][outside]).query(rest[1][inside_out])[1]]]
    owner, to = np.nonzero(distance < RADIUS)
    moved, place = np.unique(to, return_inverse=True)
    rings, lengths = _edge_graph(rest[0], faces[0][~still[faces[0]].any(axis=1)])
    edge = float(lengths.mean())
    seeds = _apart(rest[0], np.stack(matches, axis=1)[contact], SEEDS_APART * edge)
    return LayerOrder(
        steady=steady,
        yielding=yielding,
        contact=contact.astype(np.int32),
        seed_start=np.cumsum([0, *map(len, seeds)]).astype(np.int32),
        seed=np.concatenate(seeds).astype(np.int32),
        beside=_beside(distance[:, contact]),
        ring_start=rings.indptr.astype(np.int32),
        ring=rings.indices.astype(np.int32),
        push_start=np.searchsorted(owner, np.arange(len(contact) + 1)).astype(np.int32),
        push_to=place.reshape(-1).astype(np.int32),
        push_share=(np.where(loose, -1, 1)[to] * (1 - (distance[owner, to] / RADIUS) ** 2) ** 2).astype(np.float32),
        moved=moved.astype(np.int32),
        edge=edge,
    )


def _apart(vertices: np.ndarray, candidates: np.ndarray, spacing: float) -> list[np.ndarray]:
    """Of candidates (s, k), vertices (r, 3), in each row the first and then whichever is farthest from those chosen,
    while it is farther than `spacing` [m]."""
    chosen = [candidates[:, 0]]
    at = vertices[candidates]
    left = np.linalg.norm(at - at[:, :1], axis=2)
    while len(chosen) < MOST_SEEDS and left.max() > spacing:
        farthest = left.argmax(axis=1)[:, None]
        picked = np.take_along_axis(candidates, farthest, axis=1)[:, 0]
        chosen.append(np.where(left.max(axis=1) > spacing, picked, -1))
        left = np.minimum(left, np.linalg.norm(at - vertices[picked][:, None], axis=2))
    return [row[row >= 0] for row in np.stack(chosen, axis=1)]


def _beside(distance: np.ndarray) -> np.ndarray:
    """Of contacts by their distance (s, s) [m] along the cloth, some near each and some farther off: (s, 3) int32."""
    ranks = distance.argsort(axis=1, kind="stable")
    near = (distance < RADIUS).sum(axis=1)
    picked = np.arange(1, BESIDE_COUNT + 1) * near[:, None] // (BESIDE_COUNT + 1)
    return np.take_along_axis(ranks, picked, axis=1).astype(np.int32)


def _edge_graph(vertices: np.ndarray, faces: np.ndarray):
    """Sparse (n, n) symmetric graph of edge lengths, and these (e,) [m]."""
    from scipy.sparse import coo_array

    edges, _ = mesh_edges(faces)
    lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    ends = np.concatenate([edges, edges[:, ::-1]]).T
    return coo_array((np.tile(lengths, 2), ends), shape=(len(vertices),) * 2).tocsr(), lengths


def _paths(graph, sources: np.ndarray, limit: float) -> np.ndarray:
    """(s, n) [m] length of paths from each source, infinite beyond the limit."""
    from scipy.sparse.csgraph import dijkstra

    return dijkstra(graph, directed=False, indices=sources, limit=limit)
