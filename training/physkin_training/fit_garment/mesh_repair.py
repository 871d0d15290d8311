"""Repairs of a triangle mesh that change no shape: weld, drop, split, wind.

Dimensions: `n` vertices, `f` faces. Counter-clockwise is outside.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from trimesh.geometry import faces_to_edges
from trimesh.graph import connected_component_labels, face_adjacency
from trimesh.triangles import area

__all__ = [
    "compacted",
    "drop_crowded_faces",
    "drop_empty_faces",
    "face_components",
    "split_pinched_vertices",
    "weld",
    "wind_consistently",
]


def compacted(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without the vertices that no face uses."""
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(faces.shape)


def weld(vertices: np.ndarray, faces: np.ndarray, within: float) -> tuple[np.ndarray, np.ndarray, int]:
    """One vertex, the first, in place of those closer than `within` to each other; also how many went."""
    pairs = cKDTree(vertices).query_pairs(within, output_type="ndarray")
    label = connected_component_labels(pairs, node_count=len(vertices))
    _, first = np.unique(label, return_index=True)
    order = np.argsort(first)  # what remains keeps its order
    return vertices[first[order]], np.argsort(order)[label[faces]], len(vertices) - len(first)


def drop_empty_faces(vertices: np.ndarray, faces: np.ndarray, smallest: float) -> tuple[np.ndarray, int]:
    """Faces of at least the area `smallest` whose corners differ and that are no repetition; and how many went."""
    keep = (faces != np.roll(faces, 1, axis=1)).all(axis=1) & (area(vertices[faces]) >= smallest)
    first = np.zeros(len(faces), dtype=bool)
    first[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]] = True
    keep &= first
    return faces[keep], int((~keep).sum())


def drop_crowded_faces(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces without the smallest ones at edges that more than two share; and how many went."""
    before = len(faces)
    while True:
        edges, owner = faces_to_edges(faces, return_index=True)
        _, edge, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
        crowded = np.flatnonzero(count > 2)
        if len(crowded) == 0:
            return faces, before - len(faces)
        areas = area(vertices[faces])
        drop = {int(min(owner[edge.reshape(-1) == crowd], key=lambda face: areas[face])) for crowd in crowded}
        faces = np.delete(faces, sorted(drop), axis=0)


def split_pinched_vertices(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The mesh with a vertex of its own for each fan of faces; also how many vertices were added."""
    pairs, shared = face_adjacency(faces, return_edges=True)
    # Either end of a shared edge (axis 2): its corners in both faces (axis 1) belong together.
    corner = (faces[pairs][:, :, None] == shared[:, None, :, None]).argmax(axis=-1)
    together = (3 * pairs[:, :, None] + corner).swapaxes(1, 2).reshape(-1, 2)
    label = connected_component_labels(together, node_count=faces.size)
    source = faces.reshape(-1)[np.unique(label, return_index=True)[1]]
    order = np.argsort(source, kind="stable")
    added = len(source) - len(np.unique(faces))
    return vertices[source[order]], np.argsort(order)[label].reshape(faces.shape), added


def face_components(faces: np.ndarray) -> np.ndarray:
    """Number of the connected piece of each face, (f,), pieces hanging together at edges."""
    return connected_component_labels(face_adjacency(faces), node_count=len(faces))


def wind_consistently(faces: np.ndarray) -> tuple[np.ndarray, int, bool]:
    """Faces wound alike in every piece, how many were turned, and whether that was possible (not on a Moebius strip).

    The majority of a piece decides.
    """
    f = len(faces)
    pairs, shared = face_adjacency(faces, return_edges=True)
    own = faces[pairs]
    starts = np.take_along_axis(own, ((own == shared[:, :1, None]).argmax(axis=2)[..., None] + 1) % 3, axis=2)[..., 0]
    forward = starts == shared[:, 1:]
    unlike = forward[:, 0] == forward[:, 1]  # both run along their shared edge the same way
    # Two copies of each face, i as it is and f + i turned: those that are wound alike hang together, and a piece comes
    # apart into its two windings unless it has only one side.
    first, second = pairs.T
    alike = [[first, second + f * unlike], [first + f, second + f * ~unlike]]
    as_it_is, turned = connected_component_labels(np.hstack(alike).T, node_count=2 * f).reshape(2, f)
    kept = np.bincount(as_it_is, minlength=2 * f)
    turn = (kept[as_it_is] < kept[turned]) | (kept[as_it_is] == kept[turned]) & (as_it_is > turned)
    return np.where(turn[:, None], faces[:, ::-1], faces), int(turn.sum()), not (as_it_is == turned).any()
