"""Where cloth goes through itself: its edges that cross faces, and where they have to go so that the curve in which two
sheets meet gets shorter (Volino and Magnenat-Thalmann 2006, *Resolving surface collisions through intersection contour
minimization*). Nothing needs to be known of the sides on which cloth belongs.
"""

from __future__ import annotations

import numpy as np

from physkin_training.quiet_warp import wp

__all__ = ["faces_of_edges", "shorter_curve"]

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


def faces_of_edges(faces: np.ndarray, face_edges: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A face (e,) of each edge, and the third corners (e, 2) of its faces, -1 where there is one face alone."""
    order = np.argsort(face_edges.reshape(-1), kind="stable")
    edge = face_edges.reshape(-1)[order]
    again = np.concatenate([[False], edge[1:] == edge[:-1]]).astype(int)
    opposite, owner = np.full((count, 2), -1), np.empty(count, int)
    opposite[edge, again] = np.roll(faces, 1, axis=1).reshape(-1)[order]
    owner[edge] = order // 3
    return owner, opposite
