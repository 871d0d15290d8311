"""Cloth that feels itself while it is sewn: it is held off itself, and does not go through itself.

From time to time pairs of places that are near each other are looked for: a vertex and a face, or two edges. Places of
a pair that are nearer than an offset are pushed apart. No vertex goes beyond the plane halfway between the two places
of its pairs, and none so far that places in no pair could meet; so cloth that is apart stays apart, whatever a solver
does (planes of division; Chen et al. 2025, *Offset Geometric Contact*).

Where cloth goes through itself all the same, as panels may when they are hung, nothing of this holds, or it would stay
so. Instead, an edge that goes through a face is moved in the direction that shortens the curve in which the two sheets
meet (Volino and Magnenat-Thalmann 2006, *Resolving surface collisions through intersection contour minimization*).

Dimensions: `n` vertices, `f` faces, `e` edges, `p` pairs. Metres.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_training.contact.contours import faces_of_edges, goes_through_face, way_out
from physkin_training.contact.surface_queries import closest_on_face
from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest, view
from physkin_training.quiet_warp import wp

__all__ = ["ClothContact"]

wp.set_module_options({"enable_backward": False})

OFFSET = 0.003
"""[m] Cloth nearer to itself than this is pushed apart."""
STIFFNESS = 5e5
"""[J/m4]: energy = stiffness * area * (depth below the offset)^2."""
BESIDE = 0.006
"""[m] Places of one panel that are nearer than this on the flat cloth are not pushed apart."""
REACH = 0.7
"""Pairs are looked for within this share of the edges' mean length."""
KEPT = 0.9
"""Share of the distance to the plane between the places of a pair that a vertex may go."""
PAIRS = 24
"""As many pairs at most, for each vertex on average."""


@wp.struct
class Sheets:
    """The cloth. sewn: (n,) equal for vertices that become one. panel: (n,). place: (n,) [m] on the flat cloth. edges:
    (e,). opposite: (e,) third corners of an edge's faces, or -1. face_edges: (f,). owner: (e,) the face that an edge is
    looked at with. feel: (panels, panels) whether two panels feel each other. Where it was looked at last: face: (e,)
    that an edge goes through, or -1; towards: (e,) where that edge has to go; tangled: (n,) corners of such edges and
    faces."""

    sewn: wp.array(dtype=wp.int32)
    panel: wp.array(dtype=wp.int32)
    place: wp.array(dtype=wp.vec2)
    edges: wp.array(dtype=wp.vec2i)
    opposite: wp.array(dtype=wp.vec2i)
    face_edges: wp.array(dtype=wp.vec3i)
    owner: wp.array(dtype=wp.int32)
    feel: wp.array2d(dtype=wp.bool)
    face: wp.array(dtype=wp.int32)
    towards: wp.array(dtype=wp.vec3)
    tangled: wp.array(dtype=wp.bool)


@wp.struct
class Pairs:
    """count: (1,). corners: (p,) vertices, the first `split` (p,) of them on the one side. share: (p,) of each in the
    vector from the place on the other side to that on this one, whose direction and length are `apart` and `distance`.
    pushed: (p,) whether they are pushed apart where they are near."""

    count: wp.array(dtype=wp.int32)
    corners: wp.array(dtype=wp.vec4i)
    split: wp.array(dtype=wp.int32)
    share: wp.array(dtype=wp.vec4)
    apart: wp.array(dtype=wp.vec3)
    distance: wp.array(dtype=wp.float32)
    pushed: wp.array(dtype=wp.bool)


@wp.func
def append(sheets: Sheets, pairs: Pairs, corners: wp.vec4i, split: wp.int32, share: wp.vec4, away: wp.vec3):
    """Panels that do not feel each other make no pair, and what goes through itself on both sides neither."""
    if not sheets.feel[sheets.panel[corners[0]], sheets.panel[corners[3]]]:
        return
    tangled = wp.vec2i(0, 0)
    for k in range(4):
        if sheets.tangled[corners[k]]:
            tangled[wp.where(k < split, 0, 1)] = 1
    if tangled[0] + tangled[1] == 2:
        return
    at = wp.atomic_add(pairs.count, 0, 1)
    if at < pairs.corners.shape[0]:
        distance = wp.length(away)
        pairs.corners[at] = corners
        pairs.split[at] = split
        pairs.share[at] = share
        pairs.apart[at] = away / distance
        pairs.distance[at] = distance
        flat = wp.vec2(0.0, 0.0)
        for k in range(4):
            flat += share[k] * sheets.place[corners[k]]
        one_panel = sheets.panel[corners[0]] == sheets.panel[corners[3]]
        pairs.pushed[at] = not one_panel or wp.length(flat) > BESIDE


@wp.kernel
def vertex_pairs_kernel(mesh_id: wp.uint64, reach: wp.float32, sheets: Sheets, pairs: Pairs):
    """Of one vertex."""
    v = wp.tid()
    mesh = wp.mesh_get(mesh_id)
    x, own = mesh.points[v], sheets.sewn[v]
    around = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(mesh_id, x - around, x + around)
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        a, b, c = mesh.indices[3 * face], mesh.indices[3 * face + 1], mesh.indices[3 * face + 2]
        if sheets.sewn[a] != own and sheets.sewn[b] != own and sheets.sewn[c] != own:
            at = closest_on_face(x, mesh.points[a], mesh.points[b], mesh.points[c])
            away = x - at[0] * mesh.points[a] - at[1] * mesh.points[b] - at[2] * mesh.points[c]
            distance = wp.length(away)
            if distance < reach and distance > 1.0e-7:
                append(sheets, pairs, wp.vec4i(v, a, b, c), 1, wp.vec4(1.0, -at[0], -at[1], -at[2]), away)


@wp.func
def are_joined(sheets: Sheets, one: wp.vec2i, other: wp.vec2i):
    """Whether two edges have an end in common."""
    a, b, c, d = sheets.sewn[one[0]], sheets.sewn[one[1]], sheets.sewn[other[0]], sheets.sewn[other[1]]
    return a == c or a == d or b == c or b == d


@wp.func
def look_at_edges(
    points: wp.array(dtype=wp.vec3), reach: wp.float32, sheets: Sheets, pairs: Pairs, one: wp.vec2i, other: wp.vec2i
):
    if not are_joined(sheets, one, other):
        p, q, r, s = points[one[0]], points[one[1]], points[other[0]], points[other[1]]
        at = wp.closest_point_edge_edge(p, q, r, s, 1.0e-9)
        away = p + at[0] * (q - p) - r - at[1] * (s - r)
        distance = wp.length(away)
        if distance < reach and distance > 1.0e-7:
            share = wp.vec4(1.0 - at[0], at[0], at[1] - 1.0, -at[1])
            append(sheets, pairs, wp.vec4i(one[0], one[1], other[0], other[1]), 2, share, away)


@wp.kernel
def edge_pairs_kernel(mesh_id: wp.uint64, reach: wp.float32, sheets: Sheets, pairs: Pairs):
    """Of one edge."""
    e = wp.tid()
    mesh = wp.mesh_get(mesh_id)
    edge = sheets.edges[e]
    p, q = mesh.points[edge[0]], mesh.points[edge[1]]
    around = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(mesh_id, wp.min(p, q) - around, wp.max(p, q) + around)
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        for k in range(3):
            other = sheets.face_edges[face][k]
            if other > e and sheets.owner[other] == face:
                look_at_edges(mesh.points, reach, sheets, pairs, edge, sheets.edges[other])


@wp.kernel
def crossings_kernel(mesh_id: wp.uint64, sheets: Sheets):
    """Of one edge."""
    e = wp.tid()
    mesh = wp.mesh_get(mesh_id)
    ends = sheets.edges[e]
    p, q = mesh.points[ends[0]], mesh.points[ends[1]]
    sheets.face[e] = -1
    query = wp.mesh_query_aabb(mesh_id, wp.min(p, q), wp.max(p, q))
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        a, b, c = mesh.indices[3 * face], mesh.indices[3 * face + 1], mesh.indices[3 * face + 2]
        beside = are_joined(sheets, ends, wp.vec2i(a, b)) or are_joined(sheets, ends, wp.vec2i(c, c))
        if not beside and sheets.feel[sheets.panel[ends[0]], sheets.panel[a]]:
            if goes_through_face(mesh_id, p, q, face):
                sheets.face[e] = face
                sheets.towards[e] = way_out(mesh_id, p, q, face, sheets.opposite[e])
                sheets.tangled[ends[0]] = True
                sheets.tangled[ends[1]] = True
                sheets.tangled[a] = True
                sheets.tangled[b] = True
                sheets.tangled[c] = True


@wp.kernel
def push_kernel(
    drapes: Drapes, rest: Rest, pairs: Pairs, energy: wp.array2d(dtype=wp.float32), blocks: wp.array2d(dtype=wp.mat33)
):
    """One pair. Shares of either side add up to 1, so that twice their own size bounds the second derivative by blocks
    on the diagonal alone."""
    k = wp.tid()
    if not pairs.pushed[k]:
        return
    corners, share, apart = pairs.corners[k], pairs.share[k], pairs.apart[k]
    distance, area = 0.0, 0.0
    for i in range(4):
        distance += share[i] * wp.dot(drapes.x[0, corners[i]], apart)
        area += 0.5 * wp.abs(share[i]) * rest.vertex_area[0, corners[i]]
    depth = OFFSET - distance
    if depth <= 0.0:
        return
    stiffness = STIFFNESS * area
    for i in range(4):
        if share[i] != 0.0:
            wp.atomic_add(drapes.gradient, 0, corners[i], (-2.0 * stiffness * depth * share[i]) * apart)
            wp.atomic_add(blocks, 0, corners[i], (4.0 * stiffness * wp.abs(share[i])) * wp.outer(apart, apart))
    wp.atomic_add(energy, 0, corners[0], stiffness * depth * depth)


@wp.func
def corner_of(edge: wp.vec2i, indices: wp.array(dtype=wp.int32), face: wp.int32, k: wp.int32):
    if k < 2:
        return edge[k]
    return indices[3 * face + k - 2]


@wp.kernel
def untangle_kernel(
    drapes: Drapes,
    rest: Rest,
    mesh_id: wp.uint64,
    sheets: Sheets,
    energy: wp.array2d(dtype=wp.float32),
    blocks: wp.array2d(dtype=wp.mat33),
):
    """One edge that goes through a face: both are moved with the force that pushes places apart which touch."""
    e = wp.tid()
    if sheets.face[e] < 0:
        return
    mesh = wp.mesh_get(mesh_id)
    towards, stiffness = sheets.towards[e], 2.0 * STIFFNESS * rest.vertex_area[0, sheets.edges[e][0]]
    for k in range(5):
        v = corner_of(sheets.edges[e], mesh.indices, sheets.face[e], k)
        force = stiffness * OFFSET * wp.where(k < 2, 0.5, -1.0 / 3.0)
        wp.atomic_add(drapes.gradient, 0, v, -force * towards)
        wp.atomic_add(blocks, 0, v, (wp.abs(force) / OFFSET) * wp.outer(towards, towards))
        wp.atomic_add(energy, 0, v, -force * wp.dot(towards, drapes.x[0, v] - mesh.points[v]))


@wp.kernel
def add_blocks_kernel(own: wp.array2d(dtype=wp.mat33), blocks: Blocks):
    s, v = wp.tid()
    if blocks.active[s]:
        wp.atomic_add(blocks.all, s, blocks.slots[v, 0], own[s, v])


@wp.kernel
def allowed_kernel(
    pairs: Pairs, start: wp.array(dtype=wp.vec3), step: wp.array(dtype=wp.vec3), allowed: wp.array(dtype=wp.float32)
):
    """One pair: how large a share of their steps its vertices may go."""
    k = wp.tid()
    corners, apart = pairs.corners[k], pairs.apart[k]
    middle = 0.5 * pairs.distance[k]
    for i in range(4):
        if i >= pairs.split[k]:
            middle -= pairs.share[k][i] * wp.dot(start[corners[i]], apart)
    for i in range(4):
        v, side = corners[i], wp.where(i < pairs.split[k], 1.0, -1.0)
        room = KEPT * side * (wp.dot(start[v], apart) - middle)
        closer = -side * wp.dot(step[v], apart)
        if closer > room:
            wp.atomic_min(allowed, v, wp.max(room, 0.0) / closer)


class ClothContact(Energy):
    """One sample of cloth against itself. sewn: (n,) equal for vertices that become one, or are one. panel: (n,), and
    places: (n, 2) [m] on the flat cloth, of a vertex on several panels on any of them."""

    name = "own_cloth"

    def __init__(self, cloth: Cloth, sewn: np.ndarray, panel: np.ndarray, places: np.ndarray) -> None:
        garment, n = cloth.garment, len(cloth.garment.vertices)
        super().__init__(cloth, np.arange(n)[:, None])
        self._device = device = wp.device_from_torch(cloth.device)
        self._panel, self._edges = panel, len(garment.edges)
        self._reach = REACH * float(garment.edge_lengths.mean())
        self._farthest = 0.5 * KEPT * self._reach
        self._sheets, self._pairs = Sheets(), Pairs()
        owner, opposite = faces_of_edges(garment.faces, garment.face_edges, self._edges)
        tables = {"edges": garment.edges, "opposite": opposite, "face_edges": garment.face_edges, "owner": owner}
        tables |= {"sewn": sewn, "panel": panel, "face": np.full(self._edges, -1), "place": places.astype(np.float32)}
        types = {"edges": wp.vec2i, "opposite": wp.vec2i, "face_edges": wp.vec3i, "place": wp.vec2}
        for name, values in tables.items():
            setattr(self._sheets, name, wp.array(values, dtype=types.get(name, wp.int32), device=device))
        self._feel = torch.ones(panel.max() + 1, panel.max() + 1, dtype=torch.bool, device=cloth.device)
        self._tangled = torch.zeros(n, dtype=torch.bool, device=cloth.device)
        self._sheets.feel, self._sheets.tangled = wp.from_torch(self._feel), wp.from_torch(self._tangled)
        self._sheets.towards = wp.zeros(self._edges, dtype=wp.vec3, device=device)
        of_pairs = {"corners": wp.vec4i, "split": wp.int32, "share": wp.vec4, "apart": wp.vec3}
        for name, dtype in (of_pairs | {"distance": wp.float32, "pushed": wp.bool}).items():
            setattr(self._pairs, name, wp.zeros(PAIRS * n, dtype=dtype, device=device))
        self._pairs.count = wp.zeros(1, dtype=wp.int32, device=device)
        self._points = torch.tensor(garment.vertices, dtype=torch.float32, device=cloth.device)
        self._mesh = wp.Mesh(view(self._points), cloth.array(garment.faces.reshape(-1)))
        self._own = cloth.zeros(n, 3, 3)
        self.state = (self._own,)

    def look(self, vertices: torch.Tensor) -> None:
        """Find what is near, and what goes through what, at vertices (1, n, 3)."""
        self._points.copy_(vertices[0])
        self._mesh.refit()
        self._pairs.count.zero_()
        self._tangled.zero_()
        wp.launch(crossings_kernel, self._edges, [self._mesh.id, self._sheets], device=self._device)
        for kernel, count in ((vertex_pairs_kernel, len(self._points)), (edge_pairs_kernel, self._edges)):
            given = [self._mesh.id, self._reach, self._sheets, self._pairs]
            wp.launch(kernel, count, given, device=self._device)
        self._count = min(int(self._pairs.count.numpy()[0]), len(self._pairs.corners))
        self._is_tangled = bool(self._tangled.any())

    def let_through(self) -> None:
        """From now on panels that go through each other do not feel each other."""
        face = self._sheets.face.numpy()
        garment, edges = self.cloth.garment, np.flatnonzero(face >= 0)
        one, other = self._panel[garment.edges[edges, 0]], self._panel[garment.faces[face[edges], 0]]
        self._feel[one, other] = self._feel[other, one] = False

    def let_none_through(self) -> None:
        """From now on all panels feel each other."""
        self._feel.fill_(True)

    def evaluate(self, drapes: Drapes) -> None:
        self.values.zero_()
        self._own.zero_()
        own = view(self._own, wp.mat33)
        given = [drapes, self._rest, self._pairs, self._energy, own]
        wp.launch(push_kernel, self._count, given, device=self._device)
        if self._is_tangled:
            given = [drapes, self._rest, self._mesh.id, self._sheets, self._energy, own]
            wp.launch(untangle_kernel, self._edges, given, device=self._device)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._launch(add_blocks_kernel, view(self._own, wp.mat33), blocks)

    def kept_apart(self, vertices: torch.Tensor) -> torch.Tensor:
        """Vertices (1, n, 3), as far on the line from where it was looked at last as keeps cloth apart."""
        step = vertices[0] - self._points
        length = torch.linalg.vector_norm(step, dim=1, keepdim=True)
        step = step * (self._farthest / length.clamp_min(self._farthest))
        allowed = torch.ones(len(step), device=step.device)
        given = [self._pairs, view(self._points), view(step), wp.from_torch(allowed)]
        wp.launch(allowed_kernel, self._count, given, device=self._device)
        return (self._points + allowed[:, None] * step)[None]

    def is_held_back(self, vertices: torch.Tensor) -> bool:
        """Whether some of vertices (1, n, 3) are as far as they may go before it is looked at again."""
        moved = torch.linalg.vector_norm(vertices[0] - self._points, dim=1).max()
        return bool(moved > KEPT * self._farthest)
