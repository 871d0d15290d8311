"""The compact body model laid on an avatar in the canonical pose: which point of one is which point of the other.

Shape coefficients and place come from the avatar's skin, by closest points, and from those of its bones that lie where
the body model has them: in other rigs a pivot may be centimetres elsewhere in the same flesh. What the body model
cannot take on is a smooth displacement, found from coarse to fine. Any triangulation will do; a mesh with the body
model's own faces corresponds vertex by vertex. `rig_fitting` does this for meshes in any pose and without a skeleton;
here both are known, so the problem is nearly linear and takes tenths of a second.

Dimensions: `V` vertices of the body model, `c` shape coefficients, `b` bones, `k` matched vertices. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import BodyModel
from physkin_core.avatar.surface_matching import (
    NORMAL_REACH,
    TANGENTIAL,
    normal_equations,
    spread_vertices,
    with_normals,
)
from physkin_core.model.garment import face_areas, vertex_normals
from physkin_core.model.surface_sampling import sample_surface

__all__ = ["LaidBody", "lay_beneath", "lay_body"]

POINTS = 16384
"""Points sampled on the avatar."""
MATCHED = 3000
"""Vertices of the body model that are matched with them."""
ITERATIONS = 10
EXPECTED_RESIDUAL = 0.003
"""[m] mean distance between surfaces that weighs as much as coefficients of one standard deviation."""
EXACT_RESIDUAL = 1e-5
"""[m] the same where vertices correspond."""
BONE_DEVIATION = 0.01
"""[m] by which joints may be elsewhere: other rigs place them otherwise."""
STRAY_BONE = 0.02
"""[m] distance of a joint from the body model's at which it counts a quarter."""
SHAPE_WEIGHT = 0.01
"""Of an unusual shape, against matches. With twice as much, remeshed adults are fitted worse."""
OUTLIER = 0.03
"""[m] distance between matches that count a quarter of those that touch."""
RADII = (0.12, 0.08, 0.05, 0.035, 0.025)
"""[m] lengths over which the remaining displacement is averaged, one after the other."""
NEIGHBOURS = 96
"""Matched vertices over which it is averaged."""
KEPT = 4
"""Avatars on which the body model stays laid."""
CARRIED_FROM = 6
"""Matched vertices from which the displacement of a vertex is taken."""
SLACK_TRUST = 0.1
"""What clothes outside of the body count against its skin: they are wider than it, nobody knows by how much."""


@dataclass(frozen=True)
class LaidBody:
    """The body model on one avatar.

    coefficients: (c,) of the body most like the avatar, no more unusual than those that training saw. place: (3,) [m]
    of its root in the avatar's root frame. surface: (V, 3) float64 [m] the body model's vertices on the avatar's skin.
    missing: (V, 3) float64 [m] from the body of these coefficients, at its place, to `surface`.
    """

    coefficients: np.ndarray
    place: np.ndarray
    surface: np.ndarray
    missing: np.ndarray


@lru_cache(maxsize=KEPT)
def lay_body(avatar: Avatar, body: BodyModel) -> LaidBody:
    """Lay the body model on an avatar that is bound to the body model's rig. Takes tenths of a second, nothing for the
    further garments of an avatar; the result is shared, do not write into it."""
    if np.array_equal(avatar.faces, body.faces) and len(avatar.vertices) == len(body.mean_vertices):
        matching = _SameMesh(avatar, body)
    else:
        matching = _ClosestPoints(avatar, body)
    return _laid(matching, avatar, body)


def lay_beneath(skin: Avatar, clothes: Sequence[Avatar], body: BodyModel) -> LaidBody:
    """Lay the body model on a skin that is not all there, beneath clothes: these bound it, and do not draw it out."""
    return _laid(_BeneathClothes(skin, clothes, body), skin, body)


def _laid(matching: _SameMesh | _ClosestPoints, avatar: Avatar, body: BodyModel) -> LaidBody:
    coefficients, place = _fitted(matching, avatar, body)
    fitted = _body_surface(body, coefficients) + place
    missing = matching.missing(fitted)
    return LaidBody(coefficients, place, fitted + missing, missing)


def _fitted(matching: _SameMesh | _ClosestPoints, avatar: Avatar, body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (c,) and place (3,) by Gauss-Newton on pairs of points, from the shape that the bones have."""
    c = len(body.vertex_components)
    bones = np.stack([avatar.bone_heads, avatar.bone_tails], axis=1).astype(np.float64)
    by_bone = _with_place(body.bone_components.reshape(c, -1, 3))
    mean_bones = body.mean_bones.reshape(-1, 3).astype(np.float64)
    bones = bones.reshape(-1, 3)
    furthest = np.linalg.norm(body.train_bodies, axis=1).max()
    components = _with_place(body.vertex_components[:, matching.chosen])
    start = body.mean_vertices[matching.chosen].astype(np.float64)
    trust = np.full(len(bones), BONE_DEVIATION**2 / STRAY_BONE**2)
    matrix, values = np.zeros((c + 3, c + 3)), np.zeros(c + 3)
    for iteration in range(matching.iterations + 1):
        precision = trust[:, None] / (BONE_DEVIATION**2 * bones.size)
        right = values + np.einsum("uki,ki->u", by_bone, precision * (bones - mean_bones))
        system = matrix + np.einsum("uki,vki->uv", by_bone, precision * by_bone)
        unknowns = _likely(system, right, furthest)
        if iteration == matching.iterations:
            break
        stray = np.linalg.norm(mean_bones + np.einsum("u,uki->ki", unknowns, by_bone) - bones, axis=1)
        trust = 1 / (1 + (stray / STRAY_BONE) ** 2) ** 2
        target, importance = matching.matches(_body_surface(body, unknowns[:c]) + unknowns[c:])
        importance = importance / (importance.sum() * matching.expected_residual**2)
        matrix, values = normal_equations(components, start, target, importance)
    return unknowns[:c], unknowns[c:]


def _likely(system: np.ndarray, right: np.ndarray, furthest: float) -> np.ndarray:
    """Coefficients and place (c + 3,) that solve a system, the first kept within `furthest` standard deviations."""
    c, weight = len(right) - 3, SHAPE_WEIGHT
    while True:
        prior = np.diag([weight] * c + [SHAPE_WEIGHT] * 3)
        unknowns = np.linalg.solve(system + prior, right)
        if np.linalg.norm(unknowns[:c]) <= furthest:
            return unknowns
        weight *= 2


def _with_place(components: np.ndarray) -> np.ndarray:
    """(c + 3, k, 3) float64: how points move with shape coefficients (c, k, 3), and with the place."""
    place = np.broadcast_to(np.eye(3)[:, None], (3, *components.shape[1:]))
    return np.concatenate([components, place]).astype(np.float64)


def _body_surface(body: BodyModel, coefficients: np.ndarray) -> np.ndarray:
    """(V, 3) float64 [m] of the body model; summed up one by one, as BLAS would use threads (see
    `normal_equations`)."""
    surface = body.mean_vertices.astype(np.float64)
    for coefficient, component in zip(coefficients, body.vertex_components):
        surface += coefficient * component.astype(np.float64)
    return surface


class _SameMesh:
    """An avatar with the body model's own faces: pairs are known."""

    iterations, expected_residual = 1, EXACT_RESIDUAL

    def __init__(self, avatar: Avatar, body: BodyModel) -> None:
        self._points = avatar.vertices.astype(np.float64)
        self._normals = vertex_normals(self._points, body.faces)
        self.chosen = spread_vertices(body, MATCHED)

    def matches(self, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        target = with_normals(self._points[self.chosen], self._normals[self.chosen])
        return target, np.ones(len(target))

    def missing(self, surface: np.ndarray) -> np.ndarray:
        return self._points - surface


class _ClosestPoints:
    """Pairs vertices of the body model with the closest points on an avatar that face alike."""

    iterations, expected_residual = ITERATIONS, EXPECTED_RESIDUAL

    def __init__(self, avatar: Avatar, body: BodyModel) -> None:
        from scipy.spatial import cKDTree

        self._faces = body.faces
        self._points = self._sampled(avatar)
        self._tree = cKDTree(self._points)
        self.chosen = spread_vertices(body, MATCHED)

    def matches(self, surface: np.ndarray, outlier: float = OUTLIER) -> tuple[np.ndarray, np.ndarray]:
        """Points (k, 6) that the chosen vertices of a surface (V, 3) are matched with, and trust in them (k,)."""
        match, trust = self._pairs(surface, outlier)
        return self._points[match], trust

    def _pairs(self, surface: np.ndarray, outlier: float) -> tuple[np.ndarray, np.ndarray]:
        """As `matches`, with the number (k,) of each point."""
        mine = with_normals(surface, vertex_normals(surface, self._faces))[self.chosen]
        distance, match = self._tree.query(mine)
        return match, self._belief(mine, match) / (1 + (distance / outlier) ** 2) ** 2

    def _sampled(self, avatar: Avatar) -> np.ndarray:
        """Points `with_normals` (N, 6) to match with."""
        return with_normals(*sample_surface(avatar.vertices, avatar.faces, POINTS))

    def _belief(self, mine: np.ndarray, match: np.ndarray) -> np.ndarray | float:
        """Trust (k,) in matching (k, 6) with points `match` (k,), however far away these are."""
        return 1.0

    def _drawn(self, off: np.ndarray, match: np.ndarray) -> np.ndarray:
        """What vertices are drawn along normals, of the distances off (k,) [m] to points `match` (k,)."""
        return off

    def missing(self, surface: np.ndarray) -> np.ndarray:
        """Smooth displacement (V, 3) [m] of a surface (V, 3) onto the avatar.

        Every vertex moves as the pairs around it would, were they rigid: all sides of a limb say together where it is.
        """
        from scipy.spatial import cKDTree

        tree = cKDTree(surface[self.chosen])
        distance, near = tree.query(surface[self.chosen], k=NEIGHBOURS)
        to_all, carriers = tree.query(surface, k=CARRIED_FROM)
        carried = 1 / np.maximum(to_all, 1e-4) ** 2
        carried /= carried.sum(axis=1, keepdims=True)
        moved = np.zeros_like(surface)
        for radius in RADII:
            match, trust = self._pairs(surface + moved, max(OUTLIER, radius))
            target, normals = self._points[match, :3], self._points[match, 3:] / NORMAL_REACH
            off = np.einsum("ki,ki->k", target - (surface + moved)[self.chosen], normals)
            off = self._drawn(off, match)
            share = trust[near] * np.exp(-((distance / radius) ** 2))
            share /= share.sum(axis=1, keepdims=True) + 1e-9
            system = np.einsum("kn,kni,knj->kij", share, normals[near], normals[near]) + TANGENTIAL * np.eye(3)
            right = np.einsum("kn,kni->ki", share, (off[:, None] * normals)[near])
            step = np.linalg.solve(system, right[..., None])[..., 0]
            moved += np.einsum("vk,vki->vi", carried, step[carriers])
        return moved


class _BeneathClothes(_ClosestPoints):
    """Pairs vertices of the body model with points on skin and on clothes, which it may be inside of."""

    def __init__(self, skin: Avatar, clothes: Sequence[Avatar], body: BodyModel) -> None:
        self._clothes = clothes
        super().__init__(skin, body)

    def _sampled(self, avatar: Avatar) -> np.ndarray:
        surfaces = [avatar, *self._clothes]
        areas = np.array([face_areas(each.vertices, each.faces).sum() for each in surfaces])
        counts = np.maximum(POINTS * areas / areas.sum(), 1).astype(int)
        points = [with_normals(*sample_surface(s.vertices, s.faces, n)) for s, n in zip(surfaces, counts)]
        self._worn = np.repeat(np.arange(len(surfaces)) > 0, counts)
        return np.concatenate(points)

    def _belief(self, mine: np.ndarray, match: np.ndarray) -> np.ndarray:
        other = self._points[match]
        outside = ((other - mine)[:, :3] * other[:, 3:]).sum(axis=1) > 0
        return np.where(self._worn[match] & outside, SLACK_TRUST, 1.0)

    def _drawn(self, off: np.ndarray, match: np.ndarray) -> np.ndarray:
        return np.where(self._worn[match], np.minimum(off, 0), off)
