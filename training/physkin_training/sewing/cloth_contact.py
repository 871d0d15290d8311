"""Cloth that feels itself while it is sewn: it is held off itself, and never goes through itself.

Before every step of the solver pairs of places that are near each other are looked for: a vertex and a face, or two
edges. A pair that is nearer than an offset is pushed apart. No vertex goes beyond the plane halfway between the two
sides of its pairs, so that whatever the step is they are still apart after it; what is in no pair goes less far than
would bring it to another place that is in none (planes of division, after Chen et al. 2025, *Offset Geometric Contact*).

Dimensions: `n` vertices, `f` faces, `e` edges, `p` pairs. Metres.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest, view
from physkin_training.quiet_warp import wp

__all__ = ["ClothContact"]

wp.set_module_options({"enable_backward": False})

OFFSET = 0.003
"""[m] Cloth nearer to itself than this is pushed apart."""
STIFFNESS = 5e5
"""[J/m4]: energy = stiffness * area * (depth below the offset)^2."""
REACH = 0.7
"""Pairs are looked for within this share of the edges' mean length."""
KEPT = 0.9
"""Share of the distance to the plane between the two sides of a pair that a vertex may go."""
BESIDE = 0.006
"""[m] What is nearer than this on the flat cloth is not pushed apart."""
PAIRS = 24
"""As many pairs at most, a vertex on average."""


@wp.struct
class Pairs:
    """count: (1,). corners: (p, 4) vertices, and share: (p, 4) of them in the vector (p,) from the second side's
    closest point to the first's, whose direction and length are `apart` and `distance`. first: (p,) how many of them
    are of the first side. pushed: (p,) whether they are held off each other."""

    count: wp.array(dtype=wp.int32)
    corners: wp.array(dtype=wp.vec4i)
    share: wp.array(dtype=wp.vec4)
    apart: wp.array(dtype=wp.vec3)
    distance: wp.array(dtype=wp.float32)
    first: wp.array(dtype=wp.int32)
    pushed: wp.array(dtype=wp.bool)


@wp.struct
class Topology:
    """Of the cloth. sewn: (n,) equal for vertices that become one. panel: (n,). place: (n,) [m] on the flat cloth.
    edges: (e, 2). face_edges: (f, 3). owner: (e,) the face that an edge is looked at with. opposite: (e, 2)
    the third corners of an edge's faces, or -1. apart: (panels, panels) whether two panels feel each other."""

    sewn: wp.array(dtype=wp.int32)
    panel: wp.array(dtype=wp.int32)
    place: wp.array(dtype=wp.vec2)
    edges: wp.array(dtype=wp.vec2i)
    face_edges: wp.array(dtype=wp.vec3i)
    owner: wp.array(dtype=wp.int32)
    opposite: wp.array(dtype=wp.vec2i)
    apart: wp.array2d(dtype=wp.bool)
    tangled: wp.array(dtype=wp.bool)


@wp.func
def closest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Barycentric coordinates of the closest point (Ericson 2005, section 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = wp.dot(ab, ap), wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    bp = p - b
    d3, d4 = wp.dot(ab, bp), wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return wp.vec3(1.0 - v, v, 0.0)
    cp = p - c
    d5, d6 = wp.dot(ab, cp), wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return wp.vec3(1.0 - w, 0.0, w)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - w, w)
    total = va + vb + vc
    return wp.vec3(va / total, vb / total, vc / total)


@wp.func
def append(
    pairs: Pairs,
    topology: Topology,
    corners: wp.vec4i,
    share: wp.vec4,
    first: wp.int32,
    away: wp.vec3,
):
    if not topology.apart[topology.panel[corners[0]], topology.panel[corners[3]]]:
        return
    tangled = wp.vec2i(0, 0)
    for k in range(4):
        if topology.tangled[corners[k]]:
            tangled[wp.where(k < first, 0, 1)] = 1
    if tangled[0] + tangled[1] == 2:
        return
    at = wp.atomic_add(pairs.count, 0, 1)
    if at < pairs.corners.shape[0]:
        distance = wp.length(away)
        pairs.corners[at] = corners
        pairs.share[at] = share
        pairs.apart[at] = away / distance
        pairs.distance[at] = distance
        pairs.first[at] = first
        flat = wp.vec2(0.0, 0.0)
        for k in range(4):
            flat += share[k] * topology.place[corners[k]]
        one_panel = topology.panel[corners[0]] == topology.panel[corners[3]]
        pairs.pushed[at] = not one_panel or wp.length(flat) > BESIDE


@wp.kernel
def vertex_pairs_kernel(mesh_id: wp.uint64, topology: Topology, pairs: Pairs, reach: wp.float32):
    v = wp.tid()
    mesh = wp.mesh_get(mesh_id)
    x = mesh.points[v]
    around = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(mesh_id, x - around, x + around)
    face = wp.int32(0)
    own = topology.sewn[v]
    while wp.mesh_query_aabb_next(query, face):
        a, b, c = mesh.indices[3 * face], mesh.indices[3 * face + 1], mesh.indices[3 * face + 2]
        if topology.sewn[a] != own and topology.sewn[b] != own and topology.sewn[c] != own:
            at = closest_on_triangle(x, mesh.points[a], mesh.points[b], mesh.points[c])
            away = x - at[0] * mesh.points[a] - at[1] * mesh.points[b] - at[2] * mesh.points[c]
            distance = wp.length(away)
            if distance < reach and distance > 1.0e-7:
                append(pairs, topology, wp.vec4i(v, a, b, c), wp.vec4(1.0, -at[0], -at[1], -at[2]), 1, away)


@wp.func
def look_at_edges(points: wp.array(dtype=wp.vec3), topology: Topology, pairs: Pairs, reach: wp.float32, one: wp.vec2i, other: wp.vec2i):
    a, b, c, d = one[0], one[1], other[0], other[1]
    own_a, own_b, own_c, own_d = topology.sewn[a], topology.sewn[b], topology.sewn[c], topology.sewn[d]
    if own_c != own_a and own_c != own_b and own_d != own_a and own_d != own_b:
        p, q, r, s = points[a], points[b], points[c], points[d]
        at = wp.closest_point_edge_edge(p, q, r, s, 1.0e-9)
        away = (p + at[0] * (q - p)) - (r + at[1] * (s - r))
        distance = wp.length(away)
        if distance < reach and distance > 1.0e-7:
            share = wp.vec4(1.0 - at[0], at[0], at[1] - 1.0, -at[1])
            append(pairs, topology, wp.vec4i(a, b, c, d), share, 2, away)


@wp.kernel
def edge_pairs_kernel(mesh_id: wp.uint64, topology: Topology, pairs: Pairs, reach: wp.float32):
    e = wp.tid()
    mesh = wp.mesh_get(mesh_id)
    edge = topology.edges[e]
    p, q = mesh.points[edge[0]], mesh.points[edge[1]]
    around = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(mesh_id, wp.min(p, q) - around, wp.max(p, q) + around)
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        for k in range(3):
            other = topology.face_edges[face][k]
            if other > e and topology.owner[other] == face:
                look_at_edges(mesh.points, topology, pairs, reach, edge, topology.edges[other])


@wp.kernel
def crossings_kernel(mesh_id: wp.uint64, topology: Topology, tangled: wp.array(dtype=wp.bool), face: wp.array(dtype=wp.int32), along: wp.array(dtype=wp.vec3)):
    """The face that each edge goes through, or -1, and the direction [unit vector] in which the edge has to move."""
    e = wp.tid()
    mesh = wp.mesh_get(mesh_id)
    a, b = topology.edges[e][0], topology.edges[e][1]
    p, q = mesh.points[a], mesh.points[b]
    own_a, own_b = topology.sewn[a], topology.sewn[b]
    face[e] = -1
    query = wp.mesh_query_aabb(mesh_id, wp.min(p, q), wp.max(p, q))
    found = wp.int32(0)
    while wp.mesh_query_aabb_next(query, found):
        c, d, f = mesh.indices[3 * found], mesh.indices[3 * found + 1], mesh.indices[3 * found + 2]
        beside = topology.sewn[c] == own_a or topology.sewn[c] == own_b
        beside = beside or topology.sewn[d] == own_a or topology.sewn[d] == own_b
        beside = beside or topology.sewn[f] == own_a or topology.sewn[f] == own_b
        if not beside and topology.apart[topology.panel[a], topology.panel[c]]:
            x0 = mesh.points[c]
            side1, side2 = mesh.points[d] - x0, mesh.points[f] - x0
            across = wp.cross(q - p, side2)
            volume = wp.dot(side1, across)
            if wp.abs(volume) > 1.0e-16:
                u = wp.dot(p - x0, across) / volume
                turned = wp.cross(p - x0, side1)
                v = wp.dot(q - p, turned) / volume
                at = wp.dot(side2, turned) / volume
                if u > 0.0 and v > 0.0 and u + v < 1.0 and at > 0.0 and at < 1.0:
                    face[e] = found
                    edge, normal = wp.normalize(q - p), wp.normalize(wp.cross(side1, side2))
                    steep = wp.dot(edge, normal)
                    steep = wp.where(steep < 0.0, wp.min(steep, -0.1), wp.max(steep, 0.1))
                    total = wp.vec3(0.0, 0.0, 0.0)
                    for k in range(2):
                        o = topology.opposite[e][k]
                        if o >= 0:
                            inwards = mesh.points[o] - p
                            inwards = inwards - wp.dot(inwards, edge) * edge
                            ray = wp.normalize(wp.cross(normal, wp.cross(edge, inwards)))
                            if wp.dot(ray, inwards) < 0.0:
                                ray = -ray
                            total += ray - (wp.dot(ray, edge) / steep) * normal
                    along[e] = wp.normalize(total)
                    tangled[a] = True
                    tangled[b] = True
                    tangled[c] = True
                    tangled[d] = True
                    tangled[f] = True


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
    topology: Topology,
    face: wp.array(dtype=wp.int32),
    along: wp.array(dtype=wp.vec3),
    energy: wp.array2d(dtype=wp.float32),
    curvature: wp.array2d(dtype=wp.mat33),
):
    e = wp.tid()
    if face[e] < 0:
        return
    mesh = wp.mesh_get(mesh_id)
    push = along[e]
    a = topology.edges[e][0]
    force = STIFFNESS * rest.vertex_area[0, a] * OFFSET
    stiffness = 4.0 * STIFFNESS * rest.vertex_area[0, a]
    for k in range(5):
        v = corner_of(topology.edges[e], mesh.indices, face[e], k)
        share = wp.where(k < 2, 0.5, -1.0 / 3.0)
        wp.atomic_add(drapes.gradient, 0, v, (-force * share) * push)
        wp.atomic_add(curvature, 0, v, (stiffness * wp.abs(share)) * wp.outer(push, push))
        wp.atomic_add(energy, 0, v, -force * share * wp.dot(push, drapes.x[0, v] - mesh.points[v]))


@wp.kernel
def push_kernel(
    drapes: Drapes,
    rest: Rest,
    pairs: Pairs,
    energy: wp.array2d(dtype=wp.float32),
    curvature: wp.array2d(dtype=wp.mat33),
):
    """The second derivative is a bound on the diagonal blocks: shares of both sides add up to 1 each."""
    k = wp.tid()
    if k >= wp.min(pairs.count[0], pairs.corners.shape[0]) or not pairs.pushed[k]:
        return
    corners, share, apart = pairs.corners[k], pairs.share[k], pairs.apart[k]
    across = wp.vec3(0.0, 0.0, 0.0)
    area = float(0.0)
    for i in range(4):
        across += share[i] * drapes.x[0, corners[i]]
        area += 0.5 * wp.abs(share[i]) * rest.vertex_area[0, corners[i]]
    depth = OFFSET - wp.dot(across, apart)
    if depth <= 0.0:
        return
    stiffness = STIFFNESS * area
    for i in range(4):
        if share[i] != 0.0:
            wp.atomic_add(drapes.gradient, 0, corners[i], (-2.0 * stiffness * depth * share[i]) * apart)
            wp.atomic_add(curvature, 0, corners[i], (4.0 * stiffness * wp.abs(share[i])) * wp.outer(apart, apart))
    wp.atomic_add(energy, 0, corners[0], stiffness * depth * depth)


@wp.kernel
def add_curvature_kernel(curvature: wp.array2d(dtype=wp.mat33), blocks: Blocks):
    s, v = wp.tid()
    if blocks.active[s]:
        wp.atomic_add(blocks.all, s, blocks.slots[v, 0], curvature[s, v])


@wp.kernel
def allowed_kernel(
    pairs: Pairs, start: wp.array(dtype=wp.vec3), step: wp.array(dtype=wp.vec3), allowed: wp.array(dtype=wp.float32)
):
    """The share of each vertex's step that its pairs allow."""
    k = wp.tid()
    if k >= wp.min(pairs.count[0], pairs.corners.shape[0]):
        return
    corners, apart = pairs.corners[k], pairs.apart[k]
    share = pairs.share[k]
    second = wp.vec3(0.0, 0.0, 0.0)
    for i in range(4):
        if i >= pairs.first[k]:
            second -= share[i] * start[corners[i]]
    middle = wp.dot(second, apart) + 0.5 * pairs.distance[k]
    for i in range(4):
        side = 1.0
        if i >= pairs.first[k]:
            side = -1.0
        v = corners[i]
        room = KEPT * side * (wp.dot(start[v], apart) - middle)
        towards = -side * wp.dot(step[v], apart)
        if towards > room:
            wp.atomic_min(allowed, v, wp.max(room, 0.0) / towards)


class ClothContact(Energy):
    """One sample of cloth against itself. sewn: (n,) equal for vertices that become one, or are one. panel: (n,), and
    places: (n, 2) [m] on the flat cloth; of a vertex on several panels any."""

    name = "own_cloth"

    def __init__(self, cloth: Cloth, sewn: np.ndarray, panel: np.ndarray, places: np.ndarray) -> None:
        garment, n = cloth.garment, len(cloth.garment.vertices)
        super().__init__(cloth, np.arange(n)[:, None])
        self._device = wp.device_from_torch(cloth.device)
        self._reach = REACH * float(garment.edge_lengths.mean())
        self._farthest = 0.5 * KEPT * self._reach
        most = PAIRS * n
        self._pairs = pairs = Pairs()
        for name, dtype in (("corners", wp.vec4i), ("share", wp.vec4), ("apart", wp.vec3), ("distance", wp.float32)):
            setattr(pairs, name, wp.zeros(most, dtype=dtype, device=self._device))
        pairs.count = wp.zeros(1, dtype=wp.int32, device=self._device)
        pairs.first = wp.zeros(most, dtype=wp.int32, device=self._device)
        pairs.pushed = wp.zeros(most, dtype=wp.bool, device=self._device)
        self._topology = topology = Topology()
        owner = np.zeros(len(garment.edges), dtype=np.int32)
        owner[garment.face_edges] = np.arange(len(garment.faces))[:, None]
        topology.sewn, topology.panel = cloth.array(sewn), cloth.array(panel)
        topology.place = wp.array(places.astype(np.float32), dtype=wp.vec2, device=self._device)
        topology.edges = wp.array(garment.edges, dtype=wp.vec2i, device=self._device)
        topology.face_edges = wp.array(garment.face_edges, dtype=wp.vec3i, device=self._device)
        topology.owner = cloth.array(owner)
        owners = np.argsort(garment.face_edges.reshape(-1), kind="stable")
        opposite = np.full((len(garment.edges), 2), -1, dtype=np.int32)
        third = np.roll(garment.faces, 1, axis=1).reshape(-1)[owners]
        edge = garment.face_edges.reshape(-1)[owners]
        second = np.concatenate([[False], edge[1:] == edge[:-1]])
        opposite[edge, second.astype(int)] = third
        topology.opposite = wp.array(opposite, dtype=wp.vec2i, device=self._device)
        self.apart = torch.ones(panel.max() + 1, panel.max() + 1, dtype=torch.bool, device=cloth.device)
        topology.apart = wp.from_torch(self.apart)
        self._tangled = torch.zeros(n, dtype=torch.bool, device=cloth.device)
        topology.tangled = wp.from_torch(self._tangled)
        self._panel = panel
        self.crossed = torch.full((len(garment.edges),), -1, dtype=torch.int32, device=cloth.device)
        self._along = wp.zeros(len(garment.edges), dtype=wp.vec3, device=self._device)
        self._points = torch.zeros(n, 3, device=cloth.device)
        corners = cloth.array(garment.faces.reshape(-1))
        self._mesh = wp.Mesh(view(self._points), corners)
        self._curvature = cloth.zeros(n, 3, 3)
        self._blocks = view(self._curvature, wp.mat33)
        self.state = (self._curvature,)

    def look(self, vertices: torch.Tensor) -> None:
        """Find the pairs of vertices (1, n, 3)."""
        self._points.copy_(vertices[0])
        self._mesh.refit()
        self._pairs.count.zero_()
        self._tangled.zero_()
        edges = len(self._topology.edges)
        given = [self._mesh.id, self._topology, self._topology.tangled, wp.from_torch(self.crossed), self._along]
        wp.launch(crossings_kernel, edges, given, device=self._device)
        for kernel, count in ((vertex_pairs_kernel, len(self._points)), (edge_pairs_kernel, len(self._topology.edges))):
            wp.launch(kernel, count, [self._mesh.id, self._topology, self._pairs, self._reach], device=self._device)
        self._count = min(int(self._pairs.count.numpy()[0]), len(self._pairs.corners))

    def let_through(self) -> None:
        """From now on panels that cross where `look` was last do not feel each other."""
        crossing = self.crossed >= 0
        edges, faces = self.cloth.garment.edges, self.cloth.garment.faces
        through = crossing.nonzero()[:, 0].numpy()
        one = self._panel[edges[through, 0]]
        other = self._panel[faces[self.crossed[crossing].numpy(), 0]]
        print("let through", set(zip(one, other)))
        self.apart[one, other] = self.apart[other, one] = False

    def evaluate(self, drapes: Drapes) -> None:
        self.values.zero_()
        self._curvature.zero_()
        given = [drapes, self._rest, self._pairs, self._energy, self._blocks]
        wp.launch(push_kernel, self._count, given, device=self._device)
        if self._tangled.any():
            crossed = wp.from_torch(self.crossed)
            given = [drapes, self._rest, self._mesh.id, self._topology, crossed, self._along, self._energy, self._blocks]
            wp.launch(untangle_kernel, len(self._topology.edges), given, device=self._device)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._launch(add_curvature_kernel, self._blocks, blocks)

    def kept_apart(self, vertices: torch.Tensor) -> torch.Tensor:
        """Vertices (1, n, 3), on their way from where `look` was last as far as keeps pairs apart."""
        step = vertices[0] - self._points
        length = torch.linalg.vector_norm(step, dim=1, keepdim=True)
        step *= self._farthest / length.clamp_min(self._farthest)
        allowed = torch.ones(len(step), device=step.device)
        given = [self._pairs, view(self._points), view(step.contiguous()), wp.from_torch(allowed)]
        wp.launch(allowed_kernel, self._count, given, device=self._device)
        return (self._points + allowed[:, None] * step)[None].contiguous()

    def is_held_back(self, vertices: torch.Tensor) -> bool:
        """Whether some of vertices (1, n, 3) are as far from where `look` was last as they may go at most."""
        return bool((vertices[0] - self._points).square().sum(dim=1).max() > (0.9 * self._farthest) ** 2)
