"""What fits of the body model to a surface share: closest points that heed normals, and the normal equations of a step.

Distances off a surface count fully, those along it little, as any point of it would do (point to plane).

Dimensions: `k` pairs of points, `u` unknowns. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.surface_sampling import sample_surface

__all__ = ["NORMAL_REACH", "TANGENTIAL", "normal_equations", "spread_vertices", "with_normals"]

NORMAL_REACH = 0.05
"""Length [m] that a unit difference between normals counts for, so that a thigh does not pair with the other one."""
TANGENTIAL = 0.1
"""Weight of the distance along the surface against the distance off it."""


def with_normals(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(k, 6) points (k, 3) and their unit normals (k, 3) times `NORMAL_REACH`, whose distances find pairs."""
    return np.concatenate([points, NORMAL_REACH * normals], axis=1).astype(np.float64)


def spread_vertices(body: BodyModel, count: int) -> np.ndarray:
    """Indices of at most `count` vertices of the body model, spread evenly over the mean body."""
    from scipy.spatial import cKDTree

    spread, _ = sample_surface(body.mean_vertices, body.faces, count)
    return np.unique(cKDTree(body.mean_vertices).query(spread)[1])


def normal_equations(
    jacobian: np.ndarray, start: np.ndarray, target: np.ndarray, importance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (u, u) and right side (u,) of the step that brings points onto their targets.

    jacobian: (u, k, 3) of the points. start: (k, 3) where they are. target: (k, 6) `with_normals`. importance: (k,).
    """
    normals, gap = target[:, 3:] / NORMAL_REACH, target[:, :3] - start
    across = np.einsum("uki,ki->ku", jacobian, normals)
    along = TANGENTIAL * jacobian.reshape(len(jacobian), -1).T
    matrix = across.T @ (importance[:, None] * across)
    matrix += along.T @ (importance.repeat(3)[:, None] * along)
    right = across.T @ (importance * np.einsum("ki,ki->k", normals, gap))
    right += TANGENTIAL * along.T @ (importance.repeat(3) * gap.reshape(-1))
    return matrix, right
