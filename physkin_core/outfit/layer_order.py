"""The order of two layers on every frame: what of the outer one would be inside the inner one is moved out of it, and
what of a tucked one would be outside the waistband over it is moved inside.

One layer is steady, the other yields. Every vertex that may touch the steady layer has a partner there, its closest
vertex. It is looked for among those that it meets in everyday poses, the last frame's and the partners of contacts
around, which know of folds that it has not met yet, and walked from there along the mesh. The planes around the
partner, weighted by how near they are along the cloth, say how far on the right side the vertex is: that changes
continuously with the pose. What it lacks pushes it along its own normal, and less and less the vertices around it, so
that no hem flares and no spike stands out. Along the steady layer it slides as it likes.

NumPy reference; native/src/outfit/layer_order.cpp is the same in C++.

Dimensions: `n` vertices of the yielding layer, `r` of the steady one, `s` contacts, `u` vertices that may be moved.
Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.surface_paths import mesh_edges
from physkin_core.runtime.layers_beneath import LAYER_GAP

__all__ = ["TURNS", "LayerOrder", "ReferenceLayerOrder", "bind_layer_order"]

ORDER_GAP = LAYER_GAP + 0.001
"""[m] between a vertex and the steady layer, which is a little more than what holds between vertices."""
SOFT = 0.001
"""[m] Pushing sets in this much before it must, so that it begins without a kink."""
MOST_PUSH = 0.05
DEEPEST = 0.07
"""[m] A vertex farther on the wrong side is of another part of the body; over the last centimetre pushing fades."""
FADE = 0.01
FREE, FAR_ASIDE = 0.01, 2.0
"""A vertex this far [m] off its partner's plane on the right side, or this many mean edge lengths beside it, is free:
it is looked at only in its turn."""
NEAR = 0.005
"""[m] A vertex farther off its partner's plane than this is right without looking at those around."""
TURNS = 8
"""Frames in which every vertex has its turn to look for a closer partner; one that lost its own does at once."""
LOST = 1.0
"""In mean edge lengths along the cloth: a vertex farther beside its partner looks for a closer one at once."""
PLANE_REACH = 1.3
"""In mean edge lengths: planes of vertices this far along the cloth do not count."""
FULL_SHARE = 0.5
"""Planes that count less than this together, as beyond a hem, push less."""
STEPS = 3
"""The most a partner is walked at a time."""
PASSES, AGAIN = 4, 0.002
"""Times that contacts are looked at in a frame: again those that have moved by more than this [m]. In a fold a push
meets other cloth."""
BESIDE_COUNT = 3
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
    push_start: (s + 1,) into push_to (indices into `moved`) and push_share (float32, 1 for the contact itself): what
    moves along with a contact. moved: (u,) yielding vertices, in order of index, all contacts among them. edge: [m]
    mean edge length of the steady layer.
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

    @property
    def side(self) -> int:
        """On which side of the steady layer the other belongs: 1 outside, -1 inside."""
        return _side(self.steady, self.yielding)


class ReferenceLayerOrder:
    """Keeps the order of two layers frame by frame. Remembers partners from one frame to the next: those that contacts
    have before they are pushed, and those after, which lie elsewhere in a fold and would not fit the next frame."""

    def __init__(self, order: LayerOrder) -> None:
        self._order = order
        self._partner = order.seed[order.seed_start[:-1]].astype(np.int64)
        self._pushed_partner = self._partner.copy()
        own = np.arange(len(order.ring_start) - 1)
        self._ring, self._counts = _table(order.ring_start, order.ring, own)
        self._seeds = _table(order.seed_start, order.seed, self._partner)[0]
        self._free = np.zeros(len(order.contact), dtype=bool)
        self._frame = 0
        self._owner = np.repeat(np.arange(len(order.contact)), np.diff(order.push_start))

    def apply(self, steady: np.ndarray, yielding: np.ndarray, *, look_at_all: bool) -> None:
        """Move a layer. steady: (r, 6), yielding: (n, 6) x, y, z [m] and unit normals; yielding is written.

        look_at_all: do not trust the last frame in where nothing can touch.
        """
        order = self._order
        steady = steady.astype(np.float64)
        turns = look_at_all | (np.arange(len(order.contact)) % TURNS == self._frame % TURNS)
        looked_at = turns | ~self._free
        self._frame += 1
        contacts = yielding[order.contact].astype(np.float64)
        _, aside = _off_plane(contacts[:, :3], steady[self._partner])
        searches = turns | (looked_at & (aside > (LOST * order.edge) ** 2))
        partner = self._partner = self._closer(steady, contacts, self._partner, searches)
        for again in range(PASSES):
            if again:
                contacts = yielding[order.contact].astype(np.float64)
                partner = self._closer(steady, contacts, partner, looked_at)
                self._pushed_partner = np.where(looked_at, partner, self._pushed_partner)
            lack, free = self._lack(steady, contacts, partner)
            if not again:
                self._free = np.where(looked_at, free, self._free)
            lack = np.where(looked_at, lack, 0)
            push = np.zeros(len(order.moved))
            np.maximum.at(push, order.push_to, lack[self._owner] * order.push_share)
            yielding[order.moved, :3] += order.side * push[:, None] * yielding[order.moved, 3:]
            looked_at = push[np.searchsorted(order.moved, order.contact)] > AGAIN

    def _closer(
        self, steady: np.ndarray, contacts: np.ndarray, partner: np.ndarray, searches: np.ndarray
    ) -> np.ndarray:
        """Partners (s,), of those that search (s,) bool the closest vertices that they find."""
        who = np.flatnonzero(searches)
        at = contacts[who, :3]
        known = np.stack([partner[who], self._pushed_partner[who]], axis=1)
        candidates = np.concatenate([known, partner[self._order.beside[who]], self._seeds[who]], axis=1)
        found = _closest(at, steady, candidates)
        for _ in range(STEPS):
            found = _closest(at, steady, self._ring[found])
        closer = partner.copy()
        closer[who] = found
        return closer

    def _lack(self, steady: np.ndarray, contacts: np.ndarray, partner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(s,) [m] by which each contact must be pushed along its own normal, or against it; and which are free
        (s,)."""
        at, own = contacts[:, :3], contacts[:, 3:]
        edge, side = self._order.edge, self._order.side
        off, aside = _off_plane(at, steady[partner])
        off = side * off
        free = (off > FREE) | (aside > (FAR_ASIDE * edge) ** 2)
        ring = self._ring[partner]
        away, aside = _off_plane(at[:, None], steady[ring])
        share = np.maximum(1 - aside / (PLANE_REACH * edge) ** 2, 0) ** 2 * self._counts[partner]
        total = share.sum(axis=1)
        safe = np.maximum(total, 1e-6)
        gap = side * (share * away).sum(axis=1) / safe
        alike = np.einsum("si,ski,sk->s", own, steady[ring, 3:], share) / safe
        wanted = np.maximum(ORDER_GAP + SOFT - gap, 0)
        lack = np.where(wanted < 2 * SOFT, wanted**2 / (4 * SOFT), wanted - SOFT)
        lack *= np.minimum(total / FULL_SHARE, 1) * np.clip((DEEPEST + gap) / FADE, 0, 1)
        lack *= np.clip(4 * alike, 0, 1) / np.maximum(alike, 0.5)
        return np.where(free | (off > NEAR), 0, np.minimum(lack, MOST_PUSH)), free


def _side(steady: int, yielding: int) -> int:
    return 1 if yielding > steady else -1


def _table(start: np.ndarray, values: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lists as a table (k, 1 + longest), `first` (k,) before each and to fill it up; and what does not fill it up."""
    count = np.diff(start)
    slots = np.arange(count.max(initial=0))
    filled = slots < count[:, None]
    at = np.minimum(start[:-1, None] + slots, max(len(values) - 1, 0))
    table = np.concatenate([first[:, None], np.where(filled, values[at], first[:, None])], axis=1)
    return table, np.concatenate([np.ones((len(count), 1), dtype=bool), filled], axis=1)


def _closest(points: np.ndarray, steady: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """(s,) of candidates (s, k) the one closest to each of points (s, 3)."""
    squares = ((points[:, None] - steady[candidates, :3]) ** 2).sum(axis=2)
    return np.take_along_axis(candidates, squares.argmin(axis=1)[:, None], axis=1)[:, 0]


def _off_plane(points: np.ndarray, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (...) [m] of points (..., 3) from planes (..., 6), and the square of the distance along them."""
    gap = points - planes[..., :3]
    off = (gap * planes[..., 3:]).sum(axis=-1)
    return off, (gap * gap).sum(axis=-1) - off * off


def bind_layer_order(
    steady: int,
    yielding: int,
    rest: tuple[np.ndarray, np.ndarray],
    faces: tuple[np.ndarray, np.ndarray],
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
) -> LayerOrder | None:
    """Find where two layers may touch; None where they never do.

    steady, yielding: which layers. rest: their vertices (r, 3) and (n, 3) [m] at rest, of those that are computed;
    faces: (f, 3) of these. poses: (r, 6) and (n, 6) vertices and unit normals in the poses to look at, the first at
    rest.
    """
    from scipy.spatial import cKDTree

    touches, matches = np.zeros(len(rest[1]), dtype=bool), []
    side = _side(steady, yielding)
    for stays, moves in poses:
        match = cKDTree(with_normals(stays[:, :3], stays[:, 3:])).query(with_normals(moves[:, :3], moves[:, 3:]))[1]
        off, aside = _off_plane(moves[:, :3].astype(np.float64), stays[match].astype(np.float64))
        touches |= (side * off < TOUCHING) & (side * off > -DEEPEST) & (aside < BESIDE**2)
        matches.append(match)
    if not touches.any():
        return None
    graph, _ = _edge_graph(rest[1], faces[1])
    near = _paths(graph, np.flatnonzero(touches), DILATED)
    contact = np.flatnonzero(touches | np.isfinite(near).any(axis=0))
    distance = _paths(graph, contact, RADIUS)
    owner, to = np.nonzero(distance < RADIUS)
    moved, place = np.unique(to, return_inverse=True)
    rings, lengths = _edge_graph(rest[0], faces[0])
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
        push_share=((1 - (distance[owner, to] / RADIUS) ** 2) ** 2).astype(np.float32),
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
