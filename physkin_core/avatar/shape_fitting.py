"""The compact body model laid on an avatar in the canonical pose: which point of one is which point of the other.

Shape coefficients come from the avatar's bones and, by closest points, from its surface; what the body model cannot
take on is added as a smooth displacement. Any triangulation will do. `rig_fitting` does this for meshes in any pose and
without a skeleton; here both are known, so the problem is nearly linear and takes tenths of a second.

Dimensions: `V` vertices of the body model, `c` shape coefficients, `b` bones, `k` matched vertices. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import BodyModel
from physkin_core.avatar.surface_matching import NORMAL_REACH, normal_equations, spread_vertices, with_normals
from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_sampling import sample_surface

__all__ = ["fit_shape", "surface_on_avatar"]

POINTS = 16384
"""Points sampled on the avatar."""
MATCHED = 3000
"""Vertices of the body model that are matched with them."""
AT_ONCE = 80
"""Matched vertices in one product of matrices: too few for BLAS to share out among threads. On a busy machine they wait
for each other ten times as long as they compute, and hold up whoever drapes meanwhile."""
ITERATIONS = 10
EXPECTED_RESIDUAL = 0.003
"""[m] mean distance between surfaces that weighs as much as coefficients of one standard deviation."""
BONE_DEVIATION = 0.01
"""[m] by which joints may be elsewhere: other rigs place them otherwise."""
SHAPE_WEIGHT = 0.02
SMOOTHING = 0.025
"""Length [m] over which the remaining displacement is averaged."""
SMOOTHED_OVER = 24
"""Matched vertices over which it is averaged."""
OUTLIER = 0.03
"""[m] distance between matches that count a quarter of those that touch."""


def surface_on_avatar(avatar: Avatar, body: BodyModel) -> np.ndarray:
    """The body model's vertices (V, 3) float64 [m] where they lie on the avatar; its rig must be the body model's."""
    from scipy.spatial import cKDTree

    matching = _Matching(avatar, body)
    surface = matching.surface(matching.fitted())
    gap, trust = matching.gaps(surface)
    distance, near = cKDTree(surface[matching.chosen]).query(surface, k=SMOOTHED_OVER)
    share = trust[near] * np.exp(-((distance / SMOOTHING) ** 2)) + 1e-9
    return surface + np.einsum("vk,vki->vi", share / share.sum(axis=1, keepdims=True), gap[near])


def fit_shape(avatar: Avatar, body: BodyModel) -> np.ndarray:
    """Shape coefficients (c,) of the body of the body model that is most like the avatar."""
    return _Matching(avatar, body).fitted()


class _Matching:
    """Pairs vertices of the body model with points on an avatar."""

    def __init__(self, avatar: Avatar, body: BodyModel) -> None:
        from scipy.spatial import cKDTree

        self._avatar, self._body = avatar, body
        self._points = with_normals(*sample_surface(avatar.vertices, avatar.faces, POINTS))
        self._tree = cKDTree(self._points)
        self.chosen = spread_vertices(body, MATCHED)

    def fitted(self) -> np.ndarray:
        """Gauss-Newton on closest points, from the shape that the bones have."""
        body, c = self._body, len(self._body.vertex_components)
        bones = np.stack([self._avatar.bone_heads, self._avatar.bone_tails], axis=1).astype(np.float64)
        by_bone = body.bone_components.reshape(c, -1).T.astype(np.float64)
        precision = 1 / (BONE_DEVIATION**2 * len(by_bone))
        prior = SHAPE_WEIGHT * np.eye(c) + precision * by_bone.T @ by_bone
        right = precision * by_bone.T @ (bones - body.mean_bones).reshape(-1)
        coefficients = np.linalg.solve(prior, right)
        components = body.vertex_components[:, self.chosen].astype(np.float64)
        start = body.mean_vertices[self.chosen]
        blocks = [slice(first, first + AT_ONCE) for first in range(0, len(start), AT_ONCE)]
        for _ in range(ITERATIONS):
            target, trust = self._matches(self.surface(coefficients))
            importance = trust / (trust.sum() * EXPECTED_RESIDUAL**2)
            sums = [normal_equations(components[:, k], start[k], target[k], importance[k]) for k in blocks]
            matrix, values = (sum(parts) for parts in zip(*sums))
            coefficients = np.linalg.solve(prior + matrix, right + values)
        return coefficients

    def surface(self, coefficients: np.ndarray) -> np.ndarray:
        """(V, 3) float64 [m] of the body model; summed up one by one, as BLAS would use threads (see `AT_ONCE`)."""
        surface = self._body.mean_vertices.astype(np.float64)
        for coefficient, component in zip(coefficients, self._body.vertex_components):
            surface += coefficient * component.astype(np.float64)
        return surface

    def gaps(self, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is missing from the chosen vertices to the avatar, off its surface (k, 3) [m], and trust in it (k,)."""
        target, trust = self._matches(surface)
        normals = target[:, 3:] / NORMAL_REACH
        off = np.einsum("ki,ki->k", target[:, :3] - surface[self.chosen], normals)
        return off[:, None] * normals, trust

    def _matches(self, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (k, 6) that the chosen vertices are matched with, and trust in them (k,)."""
        mine = with_normals(surface, vertex_normals(surface, self._body.faces))[self.chosen]
        distance, match = self._tree.query(mine)
        return self._points[match], 1 / (1 + (distance / OUTLIER) ** 2) ** 2
