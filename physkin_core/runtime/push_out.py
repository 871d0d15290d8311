"""Push-out: moves garment vertices that skinning leaves inside the posed body onto its surface, in bounded work.

At bind time the garment is draped in sampled poses. Vertices that come near the skin they are worn on are put into
blocks, and each block keeps the body vertices that were nearest: its candidates. A body part that a vertex is not worn
on is never a candidate, so a forearm that passes through the trunk does not drag the cloth along. In a frame, the
nearest candidate of a vertex gives an estimate of its distance; where that is small, the exact signed distance to the
triangles around the candidate decides. The displacement is a smooth function of that distance alone, so nothing pops
from frame to frame.

This is the readable reference; `physkin_core.runtime.native_evaluator` runs the same in C++.

Dimensions: `n` garment vertices, `B` blocks, `V` body vertices kept, `C <= V` of them candidates, `K` influences, `b`
bones. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import vertex_normals
from physkin_core.model.skinning import cofactors, skin, unit
from physkin_core.rig.rig import Rig

__all__ = ["BLOCK", "PATCH", "BoundPushOut", "ContactResidual", "bind_push_out", "push_out"]

BLOCK = 16
"""Garment vertices that share their candidates."""
PATCH = 8
"""Triangles around a candidate that the exact distance looks at."""

CLEARANCE = 0.001
"""Distance [m] from the body to which deep vertices are pushed."""
SOFTNESS = 0.0015
"""Half the width [m] of the band around CLEARANCE in which the push sets in; beyond it vertices stay as they are."""
LOOK_CLOSER = 0.003
"""Estimated distance [m] below which the exact one is computed."""
TRUSTED_DEPTH = 0.025
LARGEST_DEPTH = 0.05
"""Between these depths [m] the push fades out: so deep, the body meets itself and the nearest skin is chance."""
TOLERATED_DEPTH = 0.0005
"""Depth [m] beyond which a vertex counts as left inside."""
BESIDE = (0.6, 0.85)
NEAR_ENOUGH = 0.002
"""Sine of the angle between the way to the closest point and the normal there at which trust begins to fade and ends;
a point nearer [m] than NEAR_ENOUGH is trusted more and more."""
ROUNDS = 2

WORN_RADIUS = 0.10
"""Body vertices farther [m] than this from a garment vertex at the canonical pose are not what it is worn on."""
BIND_REACH = 0.009
"""A sampled pose counts for a garment vertex when it comes this near [m] to the body."""
BIND_POSES = 384
BIND_SPREADS = ((0.5, 0.5), (0.25, 0.25), (1, 1))
"""Beta distributions between the joint limits, in turn: towards the limits, at most limits, anywhere."""
BIND_FARTHEST = 0.035
NEIGHBOURS = 4
"""Body vertices nearer than BIND_FARTHEST [m] that a sampled pose looks at, to find one that may count."""


@dataclass(frozen=True)
class ContactResidual:
    """What is left of a frame's contact after the push-out, with the parts of the body the garment is worn on.

    deepest: depth [m] of the deepest vertex, 0 when all are outside. left_inside: vertices deeper than 0.5 mm.
    Both cover the vertices that the push-out looked at, by the triangles it knows of: a vertex that came near a part of
    the body which no sampled pose had brought it near to is neither pushed nor counted.
    """

    deepest: float
    left_inside: int


@dataclass(frozen=True)
class BoundPushOut:
    """Constant arrays of the push-out for one garment on one body. Floats are float32, indices int32, C-contiguous.

    body_vertices: (V, 3) at the canonical pose; body_normals: (V, 3) unit; the first C are candidates.
    body_bones: (V, K); body_weights: (V, K), rows sum to 1.
    body_bend: (C,) [1/m] half the mean curvature, positive where the body is convex.
    body_patch: (C, PATCH, 3) corners of the triangles around each candidate, repeated to fill up.
    block_vertices: (B, BLOCK) garment vertices, -1 beyond the last.
    candidate_start: (B + 1,) into candidates, body vertices by block.
    """

    body_vertices: np.ndarray
    body_normals: np.ndarray
    body_bones: np.ndarray
    body_weights: np.ndarray
    body_bend: np.ndarray
    body_patch: np.ndarray
    block_vertices: np.ndarray
    candidate_start: np.ndarray
    candidates: np.ndarray


def push_out(
    bound: BoundPushOut, bone_transforms: np.ndarray, positions: np.ndarray, normals: np.ndarray | None = None
) -> ContactResidual:
    """Move vertices out of the body, in place.

    bone_transforms: (b, 3, 4) of this body. positions: (n, 3) [m]; normals: (n, 3) unit, turned towards the body's
    where a vertex was moved far.
    """
    origin = np.zeros((len(bone_transforms), 3))  # bone transforms apply to points as they are
    body, outward = skin(
        bone_transforms, origin, bound.body_vertices, bound.body_normals, bound.body_bones, bound.body_weights
    )
    deepest, left_inside = 0.0, 0
    for block, start, end in zip(
        bound.block_vertices, bound.candidate_start[:-1], bound.candidate_start[1:], strict=True
    ):
        if start == end:
            continue
        vertices, candidates = block[block >= 0], bound.candidates[start:end]
        nearest, estimate = _nearest_candidate(bound, body, outward, positions[vertices], candidates)
        close = estimate < LOOK_CLOSER
        vertices, patch = vertices[close], bound.body_patch[nearest[close]]
        if len(vertices) == 0:
            continue
        moved = positions[vertices]
        for _ in range(ROUNDS):
            distance, normal, trust = patch_distance(body, outward, patch, moved)
            moved = moved + (trust * displacement(distance))[:, None] * normal
        distance, normal, trust = patch_distance(body, outward, patch, moved)
        trusted = np.where((trust > 0.5) & (distance > -LARGEST_DEPTH), distance, 0.0)
        deepest = max(deepest, -trusted.min(initial=0.0))
        left_inside += int((trusted < -TOLERATED_DEPTH).sum())
        if normals is not None:
            far = np.linalg.norm(moved - positions[vertices], axis=1) / LOOK_CLOSER
            normals[vertices] = unit(normals[vertices] + far[:, None] * normal)
        positions[vertices] = moved
    return ContactResidual(float(deepest), left_inside)


def displacement(distance: np.ndarray) -> np.ndarray:
    """How far to move outwards [m] a vertex at a signed distance [m]; continuous, and so is its first derivative."""
    below = CLEARANCE + SOFTNESS - distance
    soft = np.clip(below, 0, 2 * SOFTNESS) ** 2 / (4 * SOFTNESS)
    push = soft + np.maximum(below - 2 * SOFTNESS, 0)
    fade = np.clip((distance + LARGEST_DEPTH) / (LARGEST_DEPTH - TRUSTED_DEPTH), 0, 1)
    return push * fade * fade * (3 - 2 * fade)


def patch_distance(
    body: np.ndarray, outward: np.ndarray, patch: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed distance (n,) [m] of points (n, 3) to the triangles patch (n, PATCH, 3), negative inside.

    Also the unit normal (n, 3) there, mixed from those of the triangle's corners, which decides the sign; and trust
    (n,) from 0 to 1: a point that does not lie along the normal is beside the patch, not in or over it.
    body: (V, 3); outward: (V, 3) unit.
    """
    a, b, c = (body[patch[..., corner]] for corner in range(3))
    barycentric = _closest_barycentric(a, b, c, points[:, None])
    closest = barycentric[..., :1] * a + barycentric[..., 1:2] * b + barycentric[..., 2:] * c
    offset = points[:, None] - closest
    best = (offset**2).sum(axis=-1).argmin(axis=1)
    rows = np.arange(len(points))
    offset = offset[rows, best]
    normal = unit(np.einsum("nc,nci->ni", barycentric[rows, best], outward[patch[rows, best]]))
    length, along = np.linalg.norm(offset, axis=1), (offset * normal).sum(axis=1)
    beside = np.linalg.norm(offset - along[:, None] * normal, axis=1) / np.maximum(length, NEAR_ENOUGH)
    trust = np.clip((BESIDE[1] - beside) / (BESIDE[1] - BESIDE[0]), 0, 1)
    return np.copysign(length, along), normal, trust * trust * (3 - 2 * trust)


def _closest_barycentric(a: np.ndarray, b: np.ndarray, c: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(..., 3) of the triangle's closest point: the projection if it falls inside, else the best of the three sides."""
    ab, ac, ap = b - a, c - a, point - a
    aa, bb, mixed = (ab * ab).sum(-1), (ac * ac).sum(-1), (ab * ac).sum(-1)
    pa, pb = (ab * ap).sum(-1), (ac * ap).sum(-1)
    area = np.maximum(aa * bb - mixed * mixed, 1e-20)
    v, w = (bb * pa - mixed * pb) / area, (aa * pb - mixed * pa) / area
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    along_ab = np.clip(pa / np.maximum(aa, 1e-12), 0, 1)
    along_ac = np.clip(pb / np.maximum(bb, 1e-12), 0, 1)
    sides = aa - 2 * mixed + bb
    along_bc = np.clip((aa - mixed - pa + pb) / np.maximum(sides, 1e-12), 0, 1)
    zero = np.zeros_like(v)
    weights = np.stack(
        [
            np.stack([1 - v - w, v, w], -1),
            np.stack([1 - along_ab, along_ab, zero], -1),
            np.stack([1 - along_ac, zero, along_ac], -1),
            np.stack([zero, 1 - along_bc, along_bc], -1),
        ]
    )
    gaps = ap - weights[..., 1:2] * ab - weights[..., 2:] * ac
    squares = (gaps * gaps).sum(-1)
    squares[0] = np.where(inside, -1.0, np.inf)
    return np.take_along_axis(weights, squares.argmin(axis=0)[None, ..., None], axis=0)[0]


def _nearest_candidate(bound: BoundPushOut, body, outward, points, candidates) -> tuple[np.ndarray, np.ndarray]:
    """Of each point: its nearest candidate, and the distance [m] to a paraboloid of the body's curvature there."""
    offset = points[:, None] - body[candidates]
    square = (offset * offset).sum(axis=-1)
    best = square.argmin(axis=1)
    rows, nearest = np.arange(len(points)), candidates[best]
    plane = (offset[rows, best] * outward[nearest]).sum(axis=-1)
    return nearest, plane + bound.body_bend[nearest] * square[rows, best]


def bind_push_out(
    drape: Callable[[np.ndarray, np.ndarray], np.ndarray], rig: Rig, avatar: Avatar, *, seed: int = 0
) -> BoundPushOut:
    """Find what the push-out needs of one body, by draping the garment in sampled poses.

    drape: joint positions (d,) [rad] and gravity (3,) -> positions and normals (n, 6), without push-out.
    """
    from scipy.spatial import cKDTree

    body, faces = np.asarray(avatar.vertices, dtype=np.float64), avatar.faces
    normals = vertex_normals(body, faces)
    rest = drape(rig.rest, np.array([0.0, 0.0, -1.0])).astype(np.float64)
    worn = _worn_on(rest, body, normals)
    kept = np.flatnonzero(worn.any(axis=0))
    worn = worn[:, kept]

    bend = _bend(body, normals, faces)[kept]
    skin_body = _BodySkin(body[kept], normals[kept], avatar.influence_bones[kept], avatar.influence_weights[kept])
    random = np.random.default_rng(seed)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for pose in range(BIND_POSES):
        share = random.beta(*BIND_SPREADS[pose % len(BIND_SPREADS)], len(rig.lower))
        q = rig.lower + share * (rig.upper - rig.lower) if pose else rig.rest
        gravity = random.normal(size=3) if pose % 4 == 3 else np.array([0.0, 0.0, -1.0])
        cloth = drape(q, gravity / np.linalg.norm(gravity))
        posed, outward = skin_body(rig.bone_transforms(q, heads=avatar.bone_heads))
        tree = cKDTree(posed, balanced_tree=False, compact_nodes=False)
        _, near = tree.query(cloth[:, :3], k=NEIGHBOURS, distance_upper_bound=BIND_FARTHEST)
        rows = np.flatnonzero(near[:, 0] < len(kept))
        found, near = near[rows] < len(kept), np.minimum(near[rows], len(kept) - 1)
        facing = np.einsum("rki,ri->rk", outward[near], cloth[rows, 3:]) > 0
        allowed = found & facing & worn[rows[:, None], near]
        nearest = near[np.arange(len(rows)), allowed.argmax(axis=1)]
        offset = cloth[rows, :3] - posed[nearest]
        height = (offset * outward[nearest]).sum(axis=1) + bend[nearest] * (offset * offset).sum(axis=1)
        counts = allowed.any(axis=1) & (height < BIND_REACH) & (height > -LARGEST_DEPTH)
        pairs.append(np.stack([rows[counts], nearest[counts]], axis=1))
    pairs = np.unique(np.concatenate(pairs), axis=0)

    blocks = _blocks(np.unique(pairs[:, 0]), rest)
    block_of = np.full(len(rest), -1)
    block_of[blocks[blocks >= 0]] = np.nonzero(blocks >= 0)[0]
    by_block = np.unique(np.stack([block_of[pairs[:, 0]], kept[pairs[:, 1]]], axis=1), axis=0)
    chosen = np.unique(by_block[:, 1])
    patches = _patches(chosen, body, faces)
    others = np.setdiff1d(patches, chosen)
    order = np.concatenate([chosen, others])
    place = np.zeros(len(body), dtype=np.int32)
    place[order] = np.arange(len(order))
    return BoundPushOut(
        body_vertices=_float(body[order]),
        body_normals=_float(normals[order]),
        body_bones=np.ascontiguousarray(avatar.influence_bones[order], dtype=np.int32),
        body_weights=_float(avatar.influence_weights[order]),
        body_bend=_float(bend[np.searchsorted(kept, chosen)]),
        body_patch=np.ascontiguousarray(place[patches], dtype=np.int32),
        block_vertices=np.ascontiguousarray(blocks, dtype=np.int32),
        candidate_start=np.searchsorted(by_block[:, 0], np.arange(len(blocks) + 1)).astype(np.int32),
        candidates=np.ascontiguousarray(place[by_block[:, 1]], dtype=np.int32),
    )


class _BodySkin:
    """Linear blend skinning of a body by matrix products, for many poses: bone transforms -> points, unit normals.

    Called with bone_transforms (b, 3, 4); returns two (V, 3) float32.
    """

    def __init__(self, body: np.ndarray, normals: np.ndarray, bones: np.ndarray, weights: np.ndarray) -> None:
        dense = np.zeros((len(body), bones.max(initial=0) + 1), dtype=np.float32)
        np.add.at(dense, (np.arange(len(body))[:, None], bones), weights)
        place = np.concatenate([body, np.ones((len(body), 1))], axis=1).astype(np.float32)
        self._bone_count = dense.shape[1]
        self._place = (dense[:, :, None] * place[:, None]).reshape(len(body), 4 * self._bone_count)
        self._weights, self._normals = dense, _float(normals)

    def __call__(self, bone_transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        transforms = _float(bone_transforms[: self._bone_count])
        columns = transforms.transpose(0, 2, 1)  # (bones, 4, 3)
        linear = (self._weights @ transforms[..., :3].reshape(-1, 9)).reshape(-1, 3, 3)
        turned = np.einsum("vij,vj->vi", cofactors(linear), self._normals)
        return self._place @ columns.reshape(-1, 3), unit(turned)


def _worn_on(rest: np.ndarray, body: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n, V) which body vertices a garment vertex may lie on: near at the canonical pose, and facing the same way."""
    from scipy.spatial import cKDTree

    worn = np.zeros((len(rest), len(body)), dtype=bool)
    near = cKDTree(body).query_ball_point(rest[:, :3], WORN_RADIUS)
    for vertex, around in enumerate(near):
        around = np.asarray(around, dtype=np.int64)
        worn[vertex, around[normals[around] @ rest[vertex, 3:] > 0]] = True
    return worn


def _blocks(vertices: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(B, BLOCK) compact groups: halved along the longest extent, front and back of a sleeve apart."""
    if len(vertices) <= BLOCK:
        return (
            np.concatenate([vertices, np.full(BLOCK - len(vertices), -1)])[None]
            if len(vertices)
            else (np.empty((0, BLOCK), dtype=np.int64))
        )
    place = rest[vertices] * [1, 1, 1, 0.1, 0.1, 0.1]
    order = vertices[np.argsort(place[:, np.ptp(place, axis=0).argmax()], kind="stable")]
    half = (len(order) // 2 + BLOCK - 1) // BLOCK * BLOCK
    return np.concatenate([_blocks(order[:half], rest), _blocks(order[half:], rest)])


def _patches(chosen: np.ndarray, body: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(C, PATCH, 3) triangles at each chosen vertex, then the nearest across their far edges, repeated to fill up."""
    at_vertex: list[list[int]] = [[] for _ in range(len(body))]
    at_edge: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(faces.tolist()):
        for vertex in (a, b, c):
            at_vertex[vertex].append(face)
        for edge in ((a, b), (b, c), (c, a)):
            at_edge.setdefault((min(edge), max(edge)), []).append(face)
    patches = np.empty((len(chosen), PATCH, 3), dtype=np.int64)
    for row, vertex in enumerate(chosen.tolist()):
        rank = dict.fromkeys(at_vertex[vertex], -1.0)
        for face in at_vertex[vertex]:
            far = [corner for corner in faces[face].tolist() if corner != vertex]
            middle = body[far].mean(axis=0)
            for across in at_edge[min(far), max(far)]:
                rank.setdefault(across, float(np.linalg.norm(middle - body[vertex])))
        patches[row] = faces[np.resize(sorted(rank, key=rank.get)[:PATCH], PATCH)]
    return patches


def _bend(body: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) [1/m] how fast the surface falls away from the tangent plane, by squared distance, to its neighbours."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.concatenate([edges, edges[:, ::-1]])
    step = body[edges[:, 1]] - body[edges[:, 0]]
    fall = -(step * normals[edges[:, 0]]).sum(axis=1) / np.maximum((step * step).sum(axis=1), 1e-12)
    total = np.bincount(edges[:, 0], weights=fall, minlength=len(body))
    return total / np.maximum(np.bincount(edges[:, 0], minlength=len(body)), 1)


def _float(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float32)
