"""Gives a garment's mesh the folds of another garment, without stretching its cloth.

Networks that were trained on a garment remove the folds of its rest mesh, vertex by vertex. On another mesh its own
folds would stay, and the negatives of the first one's would come on top. So the cloth slides over that of the other
garment until it has the same folds; where it is wider, longer or looser on the whole, it stays so.

Dimensions: `n` vertices, `v` and `f` those and the faces of the other garment. Metres, canonical pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.sparse import csr_array, eye_array
from scipy.sparse.csgraph import laplacian
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.quality import closest_points

__all__ = ["Counterparts", "MatchedFolds", "joined_vertices", "match_folds"]

MIXED = 3
"""Closest vertices whose weights are mixed, by the square of their distance."""
SOFTENED = 1e-3
"""[m] added to these distances: a vertex that lies on another takes that one's."""
BEYOND = 0.05
"""[m] Cloth farther than this from all of another garment's has no counterpart there."""
FOLDS = 0.15
"""[m] Shapes narrower than this are folds and are taken over; wider ones belong to the cut."""
PULL = 0.1
"""How strongly cloth is pulled onto the other garment's, compared with how strongly its edges keep their lengths."""
SLIDING = 0.05
"""Share of the pull that acts along the cloth, so that it can slide."""
ROUNDS = 60
PARTED = 2.0
"""Neighbours are torn apart if their counterparts are more than this many times as far apart as they are."""
FACING = 0.2
"""Least cosine between normals of cloth that faces the same way; otherwise it is the other side, or the other leg."""


@dataclass(frozen=True)
class Counterparts:
    """Where vertices lie on another garment's cloth that faces as they do: near (n, 3) indices of vertices there,
    share (n, 3) of each, rows sum to 1, and distance (n,) [m]."""

    near: np.ndarray
    share: np.ndarray
    distance: np.ndarray

    @classmethod
    def of(cls, garment: Garment, other: Garment) -> Counterparts:
        """The closest vertices of `other` to the vertices of `garment`."""
        apart, near = cKDTree(_places(other)).query(_places(garment), k=MIXED)
        share = 1 / (apart + SOFTENED) ** 2
        distance = np.linalg.norm(garment.vertices - other.vertices[near[:, 0]], axis=1)
        return cls(near, share / share.sum(axis=1, keepdims=True), distance)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """What lies there of values (v, k) of the other garment's vertices."""
        return np.einsum("nk,nki->ni", self.share, values[self.near])


@dataclass(frozen=True)
class MatchedFolds:
    """vertices (n, 3) [m] of the garment with the other one's folds, and where they lie on that one's cloth; torn (n,)
    bool: vertices whose neighbours lie elsewhere on it."""

    vertices: np.ndarray
    there: Counterparts
    torn: np.ndarray


def match_folds(garment: Garment, other: Garment) -> MatchedFolds:
    """Give a garment the folds of another one that is worn in about the same place."""
    first = Counterparts.of(garment, other)
    beyond = first.distance > BEYOND
    joined = joined_vertices(garment)
    steps = laplacian(joined)
    wide = (FOLDS / garment.edge_lengths.mean()) ** 2
    offset = splu((eye_array(len(beyond)) + wide * steps).tocsc()).solve(garment.vertices - first.mean(other.vertices))
    facing, normals = (vertex_normals(each.vertices, each.faces) for each in (garment, other))
    solve = splu((steps + PULL * eye_array(len(beyond))).tocsc()).solve
    a, b = garment.edges.T
    ends = csr_array((np.repeat([1.0, -1.0], len(a)), (np.concatenate([a, b]), np.tile(np.arange(len(a)), 2))))

    def counterparts(vertices: np.ndarray) -> tuple[Counterparts, np.ndarray, np.ndarray]:
        """The closest places, the normals there, and where these face another way."""
        distance, face, share = closest_points(vertices - offset, other.vertices, other.faces)
        there = Counterparts(other.faces[face], share, distance)
        normal = there.mean(normals)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return there, normal, (normal * facing).sum(axis=1) < FACING

    vertices = garment.vertices
    for _ in range(ROUNDS):
        there, normal, turned = counterparts(vertices)
        missing = there.mean(other.vertices) + offset - vertices
        across = (missing * normal).sum(axis=1, keepdims=True) * normal
        pull = across + SLIDING * (missing - across)
        pull[beyond | turned] = 0.0
        edges = vertices[a] - vertices[b]
        sewn = edges * (garment.edge_lengths / np.linalg.norm(edges, axis=1))[:, None]
        vertices = solve(ends @ sewn + PULL * (vertices + pull))
    there, _, turned = counterparts(vertices)
    near, share = (
        np.where(turned[:, None], old, new) for old, new in ((first.near, there.near), (first.share, there.share))
    )
    there = Counterparts(near, share, there.distance)
    places, torn = there.mean(other.vertices), np.zeros(len(beyond), dtype=bool)
    apart = np.linalg.norm(places[a] - places[b], axis=1) > PARTED * garment.edge_lengths
    apart |= _parted(there, other, a, b, garment.edge_lengths)
    for end in (a, b):
        np.logical_or.at(torn, end, apart)
    return MatchedFolds(vertices, there, torn)


def _parted(there: Counterparts, other: Garment, a: np.ndarray, b: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Which of the edges from vertices a to b (e,) of these lengths [m] have ends whose counterparts are, along the
    other garment, not beside each other: they may lie close, but on one leg and the other."""
    main = np.take_along_axis(there.near, there.share.argmax(axis=1)[:, None], axis=1)[:, 0]
    rings = 2 + math.ceil(lengths.mean() / other.edge_lengths.mean())
    step = joined_vertices(other) + eye_array(len(other.vertices), format="csr")
    reached = reduce(lambda so_far, _: (so_far @ step).sign(), range(rings - 1), step)
    return np.asarray(reached[main[a], main[b]]).ravel() == 0


def joined_vertices(garment: Garment) -> csr_array:
    """(n, n): 1 where an edge joins two vertices."""
    n = len(garment.vertices)
    pairs = np.concatenate([garment.edges, garment.edges[:, ::-1]]).T
    return csr_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(n, n))


def _places(garment: Garment) -> np.ndarray:
    return with_normals(garment.vertices, vertex_normals(garment.vertices, garment.faces))
