"""The order of two layers on every frame: what of the outer one would be inside the inner one is moved out of it.

Every outer vertex that may touch the inner layer has a partner there, its closest vertex, found when outfits are bound
and walked along the mesh where the cloth slides. The planes around the partner, weighted by how near they are along the
cloth, say how far outside the vertex is: that changes continuously with the pose. What it lacks pushes it along its own
normal, and less and less the vertices around it, so that no hem flares and no spike stands out.

NumPy reference; native/src/outfit/layer_order.cpp is the same in C++.

Dimensions: `n` vertices of the outer layer, `r` of the inner one, `s` contacts, `u` vertices that may be moved. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.surface_paths import mesh_edges
from physkin_core.outfit.dressed_body import LAYER_GAP

__all__ = ["LayerOrder", "ReferenceLayerOrder", "bind_layer_order"]

SOFT = 0.001
"""[m] Pushing sets in this much before it must, so that it begins without a kink."""
MOST_PUSH = 0.03
DEEPEST = 0.05
"""[m] A vertex deeper inside belongs to another part of the body; over the last centimetre pushing fades."""
FADE = 0.01
FREE = 0.012
"""[m] A vertex this far outside its partner's plane is left alone without looking at those around."""
STRAY = 0.6
"""In mean edge lengths along the cloth: from here on a vertex looks for a closer partner."""
PLANE_REACH = 1.3
"""In mean edge lengths: planes of vertices this far along the cloth do not count."""
FULL_SHARE = 0.5
"""Planes that count less than this together, as beyond a hem, push less."""
STEPS = 4
"""The most a partner is walked in a frame."""
RADIUS = 0.05
"""[m] along the cloth over which a push is spread."""
TOUCHING, BESIDE, DILATED = 0.025, 0.02, 0.015
"""[m] Contacts come this near in everyday poses, with a partner this near to the side; and vertices this near them."""


@dataclass(frozen=True)
class LayerOrder:
    """Two layers of an outfit, of the vertices that are computed. Index arrays are int32.

    inner, outer: which layers. contact: (s,) outer vertices; partner: (s,) the inner vertex closest to each at rest.
    ring_start: (r + 1,) into ring, the neighbours of each inner vertex. push_start: (s + 1,) into push_to (indices into
    `moved`) and push_share (float32, 1 for the contact itself): what moves along with a contact. moved: (u,) outer
    vertices. edge: [m] mean edge length of the inner layer.
    """

    inner: int
    outer: int
    contact: np.ndarray
    partner: np.ndarray
    ring_start: np.ndarray
    ring: np.ndarray
    push_start: np.ndarray
    push_to: np.ndarray
    push_share: np.ndarray
    moved: np.ndarray
    edge: float


class ReferenceLayerOrder:
    """Keeps the order of two layers frame by frame. Remembers partners from one frame to the next."""

    def __init__(self, order: LayerOrder) -> None:
        self._order = order
        self._partner = order.partner.astype(np.int64)
        count = np.diff(order.ring_start)
        slots = np.arange(count.max(initial=0))
        filled = slots < count[:, None]
        at = np.minimum(order.ring_start[:-1, None] + slots, max(len(order.ring) - 1, 0))
        own = np.arange(len(count))[:, None]
        self._ring = np.concatenate([own, np.where(filled, order.ring[at], own)], axis=1)  # (r, 1 + most neighbours)
        self._counts = np.concatenate([np.ones((len(count), 1), dtype=bool), filled], axis=1)
        self._owner = np.repeat(np.arange(len(order.contact)), np.diff(order.push_start))

    def apply(self, inner: np.ndarray, outer: np.ndarray) -> None:
        """Move the outer layer. inner: (r, 6), outer: (n, 6) x, y, z [m] and unit normals; outer is written."""
        order = self._order
        push = np.zeros(len(order.moved))
        lack = self._lack(inner.astype(np.float64), outer[order.contact].astype(np.float64))
        np.maximum.at(push, order.push_to, lack[self._owner] * order.push_share)
        outer[order.moved, :3] += push[:, None] * outer[order.moved, 3:]

    def _lack(self, inner: np.ndarray, contacts: np.ndarray) -> np.ndarray:
        """(s,) [m] by which each contact must be pushed along its own normal."""
        at, own = contacts[:, :3], contacts[:, 3:]
        edge = self._order.edge
        for _ in range(STEPS):
            off, aside = _off_plane(at, inner[self._partner])
            ring = self._ring[self._partner]
            squares = ((at[:, None] - inner[ring, :3]) ** 2).sum(axis=2)
            closest = np.take_along_axis(ring, squares.argmin(axis=1)[:, None], axis=1)[:, 0]
            self._partner = np.where(aside > (STRAY * edge) ** 2, closest, self._partner)
        off, _ = _off_plane(at, inner[self._partner])
        ring = self._ring[self._partner]
        away, aside = _off_plane(at[:, None], inner[ring])
        share = np.maximum(1 - aside / (PLANE_REACH * edge) ** 2, 0) ** 2 * self._counts[self._partner]
        total = share.sum(axis=1)
        safe = np.maximum(total, 1e-6)
        gap = (share * away).sum(axis=1) / safe
        alike = np.einsum("si,ski,sk->s", own, inner[ring, 3:], share) / safe
        wanted = np.maximum(LAYER_GAP + SOFT - gap, 0)
        lack = np.where(wanted < 2 * SOFT, wanted**2 / (4 * SOFT), wanted - SOFT)
        lack *= np.minimum(total / FULL_SHARE, 1) * np.clip((DEEPEST + gap) / FADE, 0, 1)
        lack *= np.clip(2 * alike, 0, 1) / np.maximum(alike, 0.5)
        return np.where(off > FREE, 0, np.minimum(lack, MOST_PUSH))


def _off_plane(points: np.ndarray, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (...) [m] of points (..., 3) from planes (..., 6), and the square of the distance along them."""
    gap = points - planes[..., :3]
    off = (gap * planes[..., 3:]).sum(axis=-1)
    return off, (gap * gap).sum(axis=-1) - off * off


def bind_layer_order(
    inner: int,
    outer: int,
    rest: tuple[np.ndarray, np.ndarray],
    faces: tuple[np.ndarray, np.ndarray],
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
) -> LayerOrder | None:
    """Find where two layers may touch; None where they never do.

    inner, outer: which layers. rest: their vertices (r, 3) and (n, 3) [m] at rest, of those that are computed; faces:
    (f, 3) of these. poses: (r, 6) and (n, 6) vertices and unit normals in the poses to look at, the first at rest.
    """
    from scipy.spatial import cKDTree

    touches, partner = np.zeros(len(rest[1]), dtype=bool), None
    for below, above in poses:
        match = cKDTree(with_normals(below[:, :3], below[:, 3:])).query(with_normals(above[:, :3], above[:, 3:]))[1]
        off, aside = _off_plane(above[:, :3].astype(np.float64), below[match].astype(np.float64))
        touches |= (off < TOUCHING) & (off > -DEEPEST) & (aside < BESIDE**2)
        partner = match if partner is None else partner
    if not touches.any():
        return None
    graph, _ = _edge_graph(rest[1], faces[1])
    near = _paths(graph, np.flatnonzero(touches), DILATED)
    contact = np.flatnonzero(touches | np.isfinite(near).any(axis=0))
    distance = _paths(graph, contact, RADIUS)
    owner, to = np.nonzero(distance < RADIUS)
    moved, place = np.unique(to, return_inverse=True)
    rings, lengths = _edge_graph(rest[0], faces[0])
    return LayerOrder(
        inner=inner,
        outer=outer,
        contact=contact.astype(np.int32),
        partner=partner[contact].astype(np.int32),
        ring_start=rings.indptr.astype(np.int32),
        ring=rings.indices.astype(np.int32),
        push_start=np.searchsorted(owner, np.arange(len(contact) + 1)).astype(np.int32),
        push_to=place.reshape(-1).astype(np.int32),
        push_share=((1 - (distance[owner, to] / RADIUS) ** 2) ** 2).astype(np.float32),
        moved=moved.astype(np.int32),
        edge=float(lengths.mean()),
    )


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
