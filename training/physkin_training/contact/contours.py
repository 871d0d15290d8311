"""Where cloth goes through itself: its edges that cross faces, and where they have to go so that the curve in which two
sheets meet gets shorter (Volino and Magnenat-Thalmann 2006, *Resolving surface collisions through intersection contour
minimization*). Nothing needs to be known of the sides on which cloth belongs.
"""

from __future__ import annotations

import numpy as np

from physkin_training.contact.surface_queries import goes_through
from physkin_training.quiet_warp import wp

__all__ = ["faces_of_edges", "goes_through_face", "way_out"]

wp.set_module_options({"enable_backward": False})

STEEP = 0.1
"""Cosine between an edge and a face's normal, below which it counts as this."""


@wp.func
def shorter_curve(p: wp.vec3, edge: wp.vec3, normal: wp.vec3, opposite: wp.vec3):
    """Where an edge from p along a unit vector, of a face whose third corner is given, has to go from the place where
    it crosses another face with that normal, so that the curve gets shorter which begins there."""
    inwards = opposite - p
    inwards = inwards - wp.dot(inwards, edge) * edge
    along = wp.normalize(wp.cross(normal, wp.cross(edge, inwards)))
    if wp.dot(along, inwards) < 0.0:
        along = -along
    steep = wp.dot(edge, normal)
    steep = wp.where(steep < 0.0, wp.min(steep, -STEEP), wp.max(steep, STEEP))
    return along - (wp.dot(along, edge) / steep) * normal


@wp.func
def goes_through_face(mesh_id: wp.uint64, p: wp.vec3, q: wp.vec3, face: wp.int32):
    """Whether the edge from p to q crosses a face of the mesh."""
    mesh = wp.mesh_get(mesh_id)
    a, b, c = mesh.indices[3 * face], mesh.indices[3 * face + 1], mesh.indices[3 * face + 2]
    return goes_through(p, q, mesh.points[a], mesh.points[b], mesh.points[c])


@wp.func
def way_out(mesh_id: wp.uint64, p: wp.vec3, q: wp.vec3, face: wp.int32, opposite: wp.vec2i):
    """Unit vector in which the edge from p to q has to go, out of a face that it crosses. opposite: third corners of
    the edge's faces, vertices of the mesh, or -1."""
    mesh = wp.mesh_get(mesh_id)
    edge, normal = wp.normalize(q - p), wp.mesh_eval_face_normal(mesh_id, face)
    towards = wp.vec3(0.0, 0.0, 0.0)
    for k in range(2):
        if opposite[k] >= 0:
            towards += shorter_curve(p, edge, normal, mesh.points[opposite[k]])
    return wp.normalize(towards)


def faces_of_edges(faces: np.ndarray, face_edges: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A face (e,) of each edge, and the third corners (e, 2) of its faces, -1 where there is one face alone."""
    order = np.argsort(face_edges.reshape(-1), kind="stable")
    edge = face_edges.reshape(-1)[order]
    again = np.concatenate([[False], edge[1:] == edge[:-1]]).astype(int)
    opposite, owner = np.full((count, 2), -1), np.empty(count, int)
    opposite[edge, again] = np.roll(faces, 1, axis=1).reshape(-1)[order]
    owner[edge] = order // 3
    return owner, opposite
