"""Repairs of a triangle mesh that change no shape: weld, drop, split, wind, refine.

Dimensions: `n` vertices, `f` faces. Counter-clockwise is outside.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

__all__ = [
    "boundary_loops",
    "compacted",
    "drop_crowded_faces",
    "drop_empty_faces",
    "face_components",
    "refined",
    "split_pinched_vertices",
    "weld",
    "wind_consistently",
]


def compacted(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without the vertices that no face uses."""
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(faces.shape)


def weld(vertices: np.ndarray, faces: np.ndarray, within: float) -> tuple[np.ndarray, np.ndarray, int]:
    """One vertex in place of those closer than `within` to each other; also how many went."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(vertices).query_pairs(within, output_type="ndarray")
    n = len(vertices)
    count, label = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n)), directed=False)
    first = np.full(count, n)
    np.minimum.at(first, label, np.arange(n))
    order = np.argsort(first)  # what remains keeps its order
    place = np.empty(count, dtype=np.int64)
    place[order] = np.arange(count)
    return vertices[first[order]], place[label[faces]], n - count


def drop_empty_faces(vertices: np.ndarray, faces: np.ndarray, smallest: float) -> tuple[np.ndarray, int]:
    """Faces of at least the area `smallest` whose corners differ and that are no repetition; and how many went."""
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    keep = (faces != np.roll(faces, 1, axis=1)).all(axis=1) & (area >= smallest)
    first = np.zeros(len(faces), dtype=bool)
    first[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]] = True
    keep &= first
    return faces[keep], int((~keep).sum())


def _edge_owners(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directed edges (3 f, 2), face of each, and a number that edges of the same two vertices share."""
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, edge = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    return directed, np.repeat(np.arange(len(faces)), 3), edge.reshape(-1)


def drop_crowded_faces(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces without the smallest ones at edges that more than two share; and how many went."""
    before = len(faces)
    while True:
        _, owner, edge = _edge_owners(faces)
        crowded = np.flatnonzero(np.bincount(edge) > 2)
        if len(crowded) == 0:
            return faces, before - len(faces)
        corners = vertices[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        drop = {int(min(owner[edge == crowd], key=lambda face: area[face])) for crowd in crowded}
        faces = np.delete(faces, sorted(drop), axis=0)


def split_pinched_vertices(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The mesh with a vertex of its own for each fan of faces; also how many vertices were added."""
    first, second = _neighbours(faces)
    corner = np.arange(faces.size).reshape(faces.shape)
    ends = []
    for vertex_of in (0, 1):  # the two vertices of each shared edge: their corners in both faces belong together
        shared = np.sort(_shared_vertices(faces, first, second), axis=1)[:, vertex_of]
        ends.append([corner[side, (faces[side] == shared[:, None]).argmax(axis=1)] for side in (first, second)])
    pairs = np.concatenate([np.stack(pair, axis=1) for pair in ends])
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(faces.size, faces.size))
    count, label = connected_components(graph, directed=False)
    source = np.empty(count, dtype=np.int64)
    source[label] = faces.reshape(-1)
    order = np.argsort(source, kind="stable")
    place = np.empty(count, dtype=np.int64)
    place[order] = np.arange(count)
    added = count - len(np.unique(faces))
    return vertices[source[order]], place[label].reshape(faces.shape), int(added)


def _neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces that share an edge no third face has."""
    _, owner, edge = _edge_owners(faces)
    order = np.argsort(edge, kind="stable")
    start = np.searchsorted(edge[order], np.flatnonzero(np.bincount(edge) == 2))
    return owner[order][start], owner[order][start + 1]


def _shared_vertices(faces: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    held = (faces[first][:, :, None] == faces[second][:, None, :]).any(axis=2)
    return faces[first][held].reshape(-1, 2)


def face_components(faces: np.ndarray) -> np.ndarray:
    """Number of the connected piece of each face, (f,), pieces hanging together at edges."""
    first, second = _neighbours(faces)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(len(faces), len(faces)))
    return connected_components(graph, directed=False)[1]


def wind_consistently(faces: np.ndarray) -> tuple[np.ndarray, int, bool]:
    """Faces wound alike in every piece, how many were turned, and whether that was possible (not on a Moebius strip).

    The majority of a piece decides.
    """
    first, second = _neighbours(faces)
    unlike = _wound_unlike(faces, first, second)
    f = len(faces)
    graph = coo_array((1.0 + unlike, (first, second)), shape=(f, f)).tocsr()
    graph = graph + graph.T
    turned = np.zeros(f, dtype=bool)
    for piece in range((label := face_components(faces)).max() + 1):
        members = np.flatnonzero(label == piece)
        order, before = breadth_first_order(graph, members[0], directed=False)
        step = np.asarray(graph[before[order[1:]], order[1:]]).reshape(-1) == 2
        for face, parent, flip in zip(order[1:].tolist(), before[order[1:]].tolist(), step.tolist(), strict=True):
            turned[face] = turned[parent] ^ flip
        if turned[members].sum() > len(members) / 2:
            turned[members] ^= True
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    return faces, int(turned.sum()), not _wound_unlike(faces, first, second).any()


def _wound_unlike(faces: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether both faces of a pair run along their shared edge the same way."""
    shared = _shared_vertices(faces, first, second)

    def forward(side: np.ndarray) -> np.ndarray:
        own = faces[side]
        at = (own == shared[:, :1]).argmax(axis=1)
        return own[np.arange(len(own)), (at + 1) % 3] == shared[:, 1]

    return forward(first) == forward(second)


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Vertices of every connected stretch of boundary."""
    directed, _, edge = _edge_owners(faces)
    boundary = directed[np.bincount(edge)[edge] == 1]
    if len(boundary) == 0:
        return []
    n = int(faces.max()) + 1
    _, label = connected_components(coo_array((np.ones(len(boundary)), boundary.T), shape=(n, n)), directed=False)
    return [np.unique(boundary[label[boundary[:, 0]] == loop]) for loop in np.unique(label[boundary[:, 0]])]


def refined(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every face cut into four, on the same surface."""
    directed, _, edge = _edge_owners(faces)
    ends = np.empty((edge.max() + 1, 2), dtype=np.int64)
    ends[edge] = directed
    middle = len(vertices) + edge.reshape(-1, 3)
    a, b, c = faces.T
    ab, bc, ca = middle.T
    parts = ([a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca])
    return np.concatenate([vertices, vertices[ends].mean(axis=1)]), np.concatenate([np.stack(p, 1) for p in parts])
