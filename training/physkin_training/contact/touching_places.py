"""Where a garment may touch itself: places far from a vertex along the cloth that are near it in everyday poses. They
are found once, from cloth that moves with the skin it lies on.

Dimensions: `n` garment vertices, `P` places, `K` of them a vertex at most. Metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from trimesh.triangles import closest_point

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.rig.linear_blend_skinning import dense_weights
from physkin_core.rig.rig import Rig
from physkin_training.sampling.mirrored_poses import mirrored

__all__ = ["FAR", "FOLDED_FROM", "MEETS_WITHIN", "OVER", "TouchingPlaces", "moved_with_skin"]

FAR = 0.15
"""[m] along the cloth from which on a vertex feels a place: what is nearer is mostly a fold of its own, whose sides
cannot be told from how it hangs."""
FOLDED_FROM, FOLDED = 0.045, 0.25
"""[m] along the cloth from which on a vertex feels a place that it was made upon, as the fall of a collar was upon its
stand; and how near they were made, as a share of that. Nearer along the cloth, faces around a place reach the vertex;
less close, folds of skirts would count, which open."""
SPACING, MEETS_WITHIN = 0.025, 0.04
"""[m] along the cloth to the nearest place, at most; in space to a place that is felt: its cloth may be 3 cm away."""
MOST = 32
"""Places a vertex may meet: those nearest to it in most poses."""
THROUGH = 0.005
"""[m] by which cloth may have been made on the wrong side of cloth whose outside it faces, by mistake."""
OVER = 0.7
"""Cosine to a face's normal: a vertex in a direction beyond is beside an edge of the cloth, and does not touch it."""
OUTSIDES_OPPOSED, OUTSIDES_ALIKE = 2, 3
SMOOTHINGS = 10
"""Times that what moves a vertex is averaged with what moves its neighbours: cloth spans where skin parts."""


@dataclass(frozen=True)
class TouchingPlaces:
    """candidate: (n, K) int32, for each vertex the places that it may touch, then -1. place: (P,) int32, the vertex of
    each. around_start: (P + 1,) int32 into around, the faces of what is nearest to a place along the cloth.

    side: (n, K) int8, where a vertex stays: 1 where the place's normal points, -1 behind. It is the side on which it
    lay if the garment was made so, as with a placket. Cloth that was made apart meets with its outsides, as sleeve and
    side do: this is times 2, or 3 where one is turned inside out, and counts only while normals oppose each other, or
    agree.
    """

    candidate: np.ndarray
    side: np.ndarray
    place: np.ndarray
    around_start: np.ndarray
    around: np.ndarray

    @classmethod
    def find(cls, garment: Garment, shapes: Iterable[np.ndarray], inside_out: np.ndarray) -> TouchingPlaces:
        """Of cloth that may lie as in `shapes`, (n, 3) each. inside_out: (n,) bool, see `Wearing`."""
        made, faces = garment.vertices, garment.faces
        place, owner, felt = _spread(garment)
        score = csr_array((len(made), len(place)))
        for shape in shapes:
            tree = cKDTree(shape[place])
            met = cKDTree(shape).sparse_distance_matrix(tree, MEETS_WITHIN, output_type="ndarray")
            met = met[felt[met["j"], met["i"]]]
            nearer = MEETS_WITHIN - met["v"] + 1e-6
            score = score + csr_array((nearer, (met["i"], met["j"])), shape=score.shape)
        score = score.tocoo()
        vertex, at = score.coords
        outward = np.where(inside_out, -1, 1)
        side = _sides(made, vertex_normals(made, faces), outward, vertex, place[at])
        order = np.lexsort((at, -score.data, vertex))
        order = order[side[order] != 0]
        rank = np.arange(len(order)) - np.searchsorted(vertex[order], vertex[order])
        order, rank = order[rank < MOST], rank[rank < MOST]
        candidate, sides = np.full((2, len(made), rank.max(initial=0) + 1), -1, dtype=np.int32)
        for table, values in ((candidate, at), (sides, side)):
            table[vertex[order], rank] = values[order]
        pairs = np.unique(owner[faces.reshape(-1)] * len(faces) + np.repeat(np.arange(len(faces)), 3))
        start, around = np.searchsorted(pairs, np.arange(len(place) + 1) * len(faces)), pairs % len(faces)
        lay = np.nonzero((candidate >= 0) & (np.abs(sides) == 1))
        above = _heights(made[lay[0]], made[faces[around]], start, candidate[lay])
        sides[lay] *= np.where(sides[lay] * above < -THROUGH, -1, 1)
        return cls(candidate, sides.astype(np.int8), place, start, around)


def _spread(garment: Garment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (P,) that are places; the place nearest to each vertex (n,); which vertices feel each place
    (P, n) bool."""
    n, ends = len(garment.vertices), garment.edges.T
    edges = np.tile(garment.edge_lengths, 2), np.hstack([ends, ends[::-1]])
    graph = coo_array(edges, shape=(n, n)).tocsr()
    nearest, owner = np.full(n, np.inf), np.zeros(n, dtype=int)
    places, felt = [], []
    for vertex in range(n):
        if nearest[vertex] > SPACING:
            length = dijkstra(graph, indices=vertex, limit=FAR)  # infinite beyond
            owner[length < nearest], nearest = len(places), np.minimum(length, nearest)
            straight = np.linalg.norm(garment.vertices - garment.vertices[vertex], axis=1)
            places.append(vertex), felt.append((length >= FOLDED_FROM) & (straight < FOLDED * length))
    return np.array(places), owner, np.array(felt)


def _sides(
    made: np.ndarray, normals: np.ndarray, outward: np.ndarray, vertex: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """(k,) as in `TouchingPlaces`, of vertices (k,) and those of places (k,), 0 where only insides can meet. outward:
    (n,) 1, or -1 where cloth is turned inside out."""
    gap = made[vertex] - made[other]
    before, behind = (np.einsum("ki,ki->k", gap, normals[end]) for end in (other, vertex))
    opposed = np.einsum("ki,ki->k", normals[vertex], normals[other]) < 0
    # Of curved cloth what one has too little the other has too much.
    height = before + np.where(opposed, -behind, behind)
    lay = np.where((height < 0) & ~(opposed & (height > -2 * THROUGH)), -1, 1)
    meet = (outward[other] * before > 0) | (outward[vertex] * behind < 0)
    kind = np.where(outward[vertex] == outward[other], OUTSIDES_OPPOSED, OUTSIDES_ALIKE)
    return np.where(np.linalg.norm(gap, axis=1) <= MEETS_WITHIN, lay, meet * outward[other] * kind)


def _heights(points: np.ndarray, corners: np.ndarray, start: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How far (k,) [m] points (k, 3) are above the closest face around the place (k,) of each, whose corners
    (a, 3, 3) begin at `start` (P + 1,); 0 beside it. Where cloth is rolled over, places face elsewhere."""
    count = (start[1:] - start[:-1])[place]
    point, first = np.repeat(np.arange(len(place)), count), count.cumsum() - count
    corners = corners[np.arange(count.sum()) + np.repeat(start[place] - first, count)]
    gap = points[point] - closest_point(corners, points[point])
    order = np.lexsort(((gap * gap).sum(axis=1), point))[first]
    gap, normal = gap[order], np.cross(*np.diff(corners[order], axis=1).swapaxes(0, 1))
    height = np.einsum("ki,ki->k", gap, normal) / np.linalg.norm(normal, axis=1)
    return np.where(np.abs(height) < OVER * np.linalg.norm(gap, axis=1), 0.0, height)


def moved_with_skin(
    garment: Garment, skin: np.ndarray, made_on: Avatar, bodies: Sequence[Avatar], rig: Rig
) -> Iterator[np.ndarray]:
    """The garment as it was made, and on bodies in everyday poses, (n, 3) each: it moves as the body's vertices `skin`
    (n,) do. The bodies share the mesh of the one it was made on. With a rig of other joints only as it was made."""
    yield garment.vertices
    try:
        poses = everyday_poses(rig)[0].astype(np.float64)
    except ValueError:
        return
    n, ends = len(garment.vertices), garment.edges.T
    beside = coo_array((np.ones(2 * ends.shape[1]), np.hstack([ends, ends[::-1]])), shape=(n, n)).tocsr() + eye_array(n)
    bones, weights = made_on.influence_bones[skin], made_on.influence_weights[skin]
    moved = [dense_weights(bones, weights, rig.bone_count)]
    moved += [body.vertices[skin] - made_on.vertices[skin] for body in bodies]
    for _ in range(SMOOTHINGS):
        moved = [beside @ values / beside.sum(axis=1)[:, None] for values in moved]
    for index, body in enumerate(bodies):
        grown = garment.vertices + moved[1 + index]
        for positions in mirrored(rig, poses) if index % 2 else poses:
            moves = np.tensordot(moved[0], rig.bone_transforms(positions, heads=body.bone_heads), 1)
            yield np.einsum("nij,nj->ni", moves[..., :3], grown) + moves[..., 3]
