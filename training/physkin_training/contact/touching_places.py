"""Where a garment may touch itself in everyday poses: places near each other in space, and far along the cloth.

Places are spread over the cloth. Each vertex has a list of those that it may meet, and on which side of them it stays.
Where they lay on each other already as the garment was made, as the two sides of a placket do, that is the side it lay
on there. Elsewhere, as of a sleeve and the side of a shirt, the outsides of both meet.

They are found once, from cloth that moves with the skin it lies on, on a lean and on a stout body. Dimensions: `n`
garment vertices, `P` places, `K` of them a vertex at most, `b` bones, `V` body vertices. Metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.rig.linear_blend_skinning import dense_weights
from physkin_core.rig.rig import Rig
from physkin_training.sampling.mirrored_poses import mirrored

__all__ = ["MEETS_WITHIN", "TouchingPlaces", "moved_with_skin"]

FAR, CREASE, FOLD = 0.045, 0.09, 0.15
"""[m] along the cloth from which on a vertex feels a place; up to which it may anywhere, as cloth creases where it likes;
and up to which both are sides of one fold."""
SPACING = 0.025
"""[m] along the cloth from each vertex to the nearest place, at most."""
NEAR = 0.03
"""[m] at which cloth is near other cloth: as it was made it then lies on it, in everyday poses it may touch it."""
MEETS_WITHIN = 0.04
"""[m] from a vertex to a place whose cloth is near it: the place itself may lie aside."""
MOST = 32
"""Places a vertex may meet: of more it keeps those that it is nearest to most often in everyday poses, and of those that
only a crease brings together the ones that are nearest along the cloth."""
THROUGH = 0.005
"""[m] As it was made, cloth whose outsides face each other may be so far on the wrong side by mistake."""
NEAR_ALONG = -2
LEAST = 1e-12
SMOOTHINGS = 10
"""Times that what moves a vertex is averaged with what moves its neighbours: cloth spans where skin parts."""


@dataclass(frozen=True)
class TouchingPlaces:
    """candidate: (n, K) int32, for each vertex the places that it may touch, then -1. side: (n, K) int8, 1 if it stays
    where the place's normal points, -1 if behind; times two where that counts only while the cloth's normals oppose
    each other, times three while they agree. place: (P,) int32 vertices. around_start: (P + 1,) int32 into around, the
    faces of a place and of what is nearest to it."""

    candidate: np.ndarray
    side: np.ndarray
    middle: np.ndarray
    place: np.ndarray
    around_start: np.ndarray
    around: np.ndarray

    @classmethod
    def find(cls, garment: Garment, shapes: Iterable[np.ndarray], inside_out: np.ndarray) -> TouchingPlaces:
        """Of cloth that may lie as in `shapes`, (n, 3) each. inside_out: (n,) bool, see `Wearing`."""
        places = _Places(garment)
        made, normals = garment.vertices, vertex_normals(garment.vertices, garment.faces)
        outward = np.where(inside_out, -1, 1)
        score = places.of_creases
        for shape in shapes:
            vertex, place, distance = places.met_by(shape)
            faces_out = outward[:, None] * vertex_normals(shape, garment.faces)
            at = places.vertex[place]
            opposed = np.einsum("ki,ki->k", faces_out[vertex], faces_out[at]) < 0
            beside = np.linalg.norm(made[vertex] - made[at], axis=1) < 2 * NEAR
            keep = opposed | beside
            nearness = (MEETS_WITHIN - distance[keep]) ** 2 + LEAST
            score = score + csr_array((nearness, (vertex[keep], place[keep])), shape=score.shape)
        score = score.tocoo()
        vertex, place = score.coords
        middle = places.middle[place, vertex]
        side = _sides(made, normals, outward, vertex, places.nearest_of_sheet(made, vertex, place))
        side[middle >= 0] = 0
        order = np.lexsort((place, -score.data, vertex))
        order = order[(side[order] != 0) | (middle[order] >= 0)]
        vertex, place, side, middle = (each[order] for each in (vertex, place, side, middle))
        rank = np.arange(len(vertex)) - np.searchsorted(vertex, vertex)
        some = rank < MOST
        shape = (len(made), min(MOST, int(rank.max(initial=0)) + 1))
        at = vertex[some], rank[some]
        candidate, middles = np.full((2, *shape), -1, dtype=np.int32)
        sides = np.zeros(shape, dtype=np.int8)
        candidate[at], middles[at], sides[at] = place[some], middle[some], side[some]
        return cls(candidate, sides, middles, places.vertex.astype(np.int32), *places.faces_around(garment.faces))


class _Places:
    """vertex: (P,) of each place. owner: (n,), the place that is nearest to each vertex along the cloth. middle: (P, n),
    see `_middles`. sheet: of each place the vertices of the cloth about it. of_creases: (n, P) sparse, a score of places
    that a crease may bring to each vertex."""

    def __init__(self, garment: Garment) -> None:
        n, ends = len(garment.vertices), garment.edges.T
        lengths = np.tile(garment.edge_lengths, 2), np.hstack([ends, ends[::-1]])
        graph = coo_array(lengths, shape=(n, n)).tocsr()
        closest, self.owner = np.full(n, np.inf), np.zeros(n, dtype=int)
        chosen, middles, self.sheet, creases = [], [], [], []
        for vertex in range(n):
            if closest[vertex] > SPACING:
                length, before = dijkstra(graph, indices=vertex, limit=FOLD, return_predecessors=True)
                mine = length < closest
                closest[mine], self.owner[mine] = length[mine], len(chosen)
                middles.append(_middles(length, before))
                about = np.flatnonzero((length >= FAR) & (length < CREASE))
                creases.append((np.full(len(about), len(chosen)), about, LEAST * (1 - length[about])))
                self.sheet.append(np.flatnonzero(length < 2 * NEAR))
                chosen.append(vertex)
        self.vertex, self.middle = np.array(chosen), np.array(middles)
        place, vertex, score = map(np.concatenate, zip(*creases))
        self.of_creases = csr_array((score, (vertex, place)), shape=self.middle.T.shape)

    def met_by(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices (k,), places (k,) far from them along the cloth, and their distances (k,) [m] in a shape (n, 3)."""
        tree = cKDTree(shape[self.vertex])
        pairs = cKDTree(shape).sparse_distance_matrix(tree, MEETS_WITHIN, output_type="ndarray")
        pairs = pairs[self.middle[pairs["j"], pairs["i"]] != NEAR_ALONG]
        return pairs["i"], pairs["j"], pairs["v"]

    def nearest_of_sheet(self, made: np.ndarray, vertex: np.ndarray, place: np.ndarray) -> np.ndarray:
        """(k,) the vertex about each place (k,) that is closest to a vertex (k,) in a shape (n, 3)."""
        nearest = np.zeros(len(vertex), dtype=int)
        order = np.argsort(place, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(place[order])) + 1):
            if len(rows):
                sheet = self.sheet[place[rows[0]]]
                nearest[rows] = sheet[cKDTree(made[sheet]).query(made[vertex[rows]])[1]]
        return nearest

    def faces_around(self, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Starts (P + 1,) and faces, as of `TouchingPlaces`."""
        face, place = np.repeat(np.arange(len(faces)), 3), self.owner[faces.reshape(-1)]
        pairs = np.unique(place * len(faces) + face)
        start = np.searchsorted(pairs, np.arange(len(self.vertex) + 1) * len(faces))
        return start.astype(np.int32), (pairs % len(faces)).astype(np.int32)


def _middles(length: np.ndarray, before: np.ndarray) -> np.ndarray:
    """(n,) int32 the vertex half of the way to each, on paths of lengths (n,) [m] along which `before` (n,) is the one
    before each; -1 where none leads, `NEAR_ALONG` where that is not far."""
    middle = np.full(len(length), -1, dtype=np.int32)
    reached = np.flatnonzero(np.isfinite(length))
    at = reached.copy()
    while (beyond := length[at] > length[reached] / 2).any():
        at[beyond] = before[at[beyond]]
    middle[reached] = np.where(length[reached] < FAR, NEAR_ALONG, at)
    return middle


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
    count = beside.sum(axis=1)[:, None]

    def smoothed(values: np.ndarray) -> np.ndarray:
        for _ in range(SMOOTHINGS):
            values = beside @ values / count
        return values

    bones, weights = made_on.influence_bones[skin], made_on.influence_weights[skin]
    weights = smoothed(dense_weights(bones, weights, rig.bone_count))
    for index, body in enumerate(bodies):
        grown = garment.vertices + smoothed(body.vertices[skin] - made_on.vertices[skin])
        for positions in mirrored(rig, poses) if index % 2 else poses:
            moves = np.tensordot(weights, rig.bone_transforms(positions, heads=body.bone_heads), 1)
            yield np.einsum("nij,nj->ni", moves[..., :3], grown) + moves[..., 3]


def _sides(
    made: np.ndarray, normals: np.ndarray, outward: np.ndarray, vertex: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """(k,) int8, as in `TouchingPlaces`, of vertices (k,) and those nearest to them about a place; 0 where cloth was
    made to meet from inside. outward (n,): 1, or -1 where cloth is turned inside out."""
    gap = made[vertex] - made[other]
    height, back = (np.einsum("ki,ki->k", gap, normals[end]) for end in (other, vertex))
    opposed = np.einsum("ki,ki->k", normals[vertex], normals[other]) < 0
    over = np.where((height < 0) & ~(opposed & (height > -THROUGH)), -1, 1)
    before = (outward[other] * height > 0) | (outward[vertex] * back < 0)
    meets = outward[other] * np.where(outward[vertex] == outward[other], 2, 3)
    return np.where(np.linalg.norm(gap, axis=1) <= NEAR, over, np.where(before, meets, 0)).astype(np.int8)
