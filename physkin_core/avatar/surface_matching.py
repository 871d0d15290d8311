"""What fits of the body model to a surface share: closest points that heed normals, and the normal equations of a step.

Distances off a surface count fully, those along it little, as any point of it would do (point to plane).

Dimensions: `k` pairs of points, `u` unknowns. Metres.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.surface_sampling import sample_surface

__all__ = ["NORMAL_REACH", "TANGENTIAL", "normal_equations", "spread_vertices", "with_normals"]

NORMAL_REACH = 0.05
"""Length [m] that a unit difference between normals counts for, so that a thigh does not pair with the other one."""
TANGENTIAL = 0.1
"""Weight of the distance along the surface against the distance off it."""
ONE_THREAD = 2**17
"""Multiplications in one product of matrices, too few for BLAS to share them out among threads. On a busy machine these
wait for each other ten times as long as they compute, and hold up whoever drapes meanwhile."""


def with_normals(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(k, 6) points (k, 3) and their unit normals (k, 3) times `NORMAL_REACH`, whose distances find pairs."""
    return np.concatenate([points, NORMAL_REACH * normals], axis=1).astype(np.float64)


@cache
def spread_vertices(body: BodyModel, count: int) -> np.ndarray:
    """Indices of at most `count` vertices of the body model, spread evenly over the mean body; shared, do not write."""
    from scipy.spatial import cKDTree

    spread, _ = sample_surface(body.mean_vertices, body.faces, count)
    return np.unique(cKDTree(body.mean_vertices).query(spread)[1])


def normal_equations(
    jacobian: np.ndarray, start: np.ndarray, target: np.ndarray, importance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (u, u) and right side (u,) of the step that brings points onto their targets.

    jacobian: (u, k, 3) of the points. start: (k, 3) where they are. target: (k, 6) `with_normals`. importance: (k,).
    """
    unknowns, pairs = len(jacobian), len(start)
    normals, gap = target[:, 3:] / NORMAL_REACH, target[:, :3] - start
    rows = np.zeros((pairs, 4, unknowns + 1))  # off the surface, then along each axis; what is to be reached comes last
    rows[:, 0, :-1] = np.einsum("uki,ki->ku", jacobian, normals)
    rows[:, 0, -1] = np.einsum("ki,ki->k", normals, gap)
    rows[:, 1:, :-1] = TANGENTIAL * jacobian.transpose(1, 2, 0)
    rows[:, 1:, -1] = TANGENTIAL * gap
    trusted = (importance[:, None, None] * rows).reshape(4 * pairs, -1)
    rows = rows.reshape(4 * pairs, -1)
    at_once = max(1, ONE_THREAD // (unknowns + 1) ** 2)
    whole = len(rows) // at_once * at_once
    blocks, others = (each[:whole].reshape(-1, at_once, unknowns + 1) for each in (rows, trusted))
    product = (blocks.transpose(0, 2, 1) @ others).sum(axis=0) + rows[whole:].T @ trusted[whole:]
    return product[:-1, :-1], product[:-1, -1]
