"""Cloth at rest kept as clear of an avatar's skin as networks keep it of the body that they see.

What carries cloth from that body to the avatar is smooth; skin with ridges, joints of a doll, is not. Vertices that
come too near are moved out, and with them, less, those around. Where skin moves otherwise than that body's, about other
pivots or with other skinning weights, cloth gets room. All this once, when the garment is bound.

Dimensions: `n` garment vertices. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.rig.rig import Rig
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import drape_poses
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY

__all__ = ["SkinClearance", "draped_at_rest", "move_clear", "room_to_move"]

POINTS = 24576
"""Points sampled on a body at rest."""
POSED_POINTS = 8192
"""Points sampled on a body in a pose."""
WIDE_POSES, WIDE_RANGE = 12, 0.7
"""Poses beside the everyday ones, and the share of joint limits in which each joint is drawn by itself."""
MEASURED = 2500
"""Vertices of a garment that are measured in poses, about."""
NEAR_GARMENT = 0.15
"""[m] Skin farther than this from the garment at rest is left out in poses."""
MOST_ROOM = 0.02
"""[m] The most that cloth is moved for skin that moves otherwise."""
CLEAR = 0.004
"""[m] Cloth farther from the skin than this is left where it is."""
FAR = 0.05
"""[m] A vertex with no skin so near that faces as it does is left where it is."""
RADIUS = 0.03
"""[m] length over which vertices move along with those that must."""
NEIGHBOURS = 48
ROUNDS = 6
AT_REST = 0.3
"""What a vertex that need not move counts, against one that must, in how those around them move."""


class SkinClearance:
    """Measures how far points that face outward are from a body's skin."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, points: int = POINTS) -> None:
        from scipy.spatial import cKDTree

        self._points, self._normals = (a.astype(np.float64) for a in sample_surface(vertices, faces, points))
        self._tree = cKDTree(with_normals(self._points, self._normals), balanced_tree=False)

    def __call__(self, vertices: np.ndarray, normals: np.ndarray, *, far: float = FAR) -> tuple[np.ndarray, np.ndarray]:
        """Clearance (n,) [m] of vertices (n, 3) with normals (n, 3), negative inside, infinite where no skin that faces
        alike is within `far` [m]; and the skin's normals (n, 3)."""
        match = self._tree.query(with_normals(vertices, normals))[1]
        gap = vertices - self._points[match]
        off = np.einsum("ni,ni->n", gap, self._normals[match])
        return np.where(np.linalg.norm(gap, axis=1) < far, off, np.inf), self._normals[match]

    def of_nearest(self, vertices: np.ndarray) -> np.ndarray:
        """Clearance (n,) [m] of vertices (n, 3) from the skin nearest to them, whichever way they face."""
        from scipy.spatial import cKDTree

        match = cKDTree(self._points, balanced_tree=False).query(vertices)[1]
        return np.einsum("ni,ni->n", vertices - self._points[match], self._normals[match])


def move_clear(vertices: np.ndarray, faces: np.ndarray, wanted: np.ndarray, skin: SkinClearance) -> np.ndarray:
    """Displacement (n, 3) [m] that gives cloth (n, 3) its wanted clearance (n,) of a skin, at most `CLEAR`."""
    from scipy.spatial import cKDTree

    wanted = np.minimum(wanted, CLEAR)
    distance, near = cKDTree(vertices).query(vertices, k=min(NEIGHBOURS, len(vertices)))
    closeness = np.exp(-((distance / RADIUS) ** 2))
    moved = np.zeros_like(vertices)
    for _ in range(ROUNDS):
        there = vertices + moved
        clearance, outward = skin(there, vertex_normals(there, faces))
        lack = np.maximum(wanted - clearance, 0)
        if not lack.any():
            break
        share = closeness * np.where(lack > 0, 1.0, AT_REST)[near]
        share /= share.sum(axis=1, keepdims=True)
        moved += np.einsum("nk,nki->ni", share, (lack[:, None] * outward)[near])
    return moved


def draped_at_rest(bound: BoundGarment) -> np.ndarray:
    """Vertices (n, 3) float64 [m] of a bound garment at the canonical pose of an upright body."""
    (cloud,) = drape_poses(bound, [(bound.dof_rest, UPRIGHT_GRAVITY)], precision="fp32")
    return cloud[:, :3].astype(np.float64)


def room_to_move(bound: BoundGarment, avatar: Avatar, rig: Rig) -> np.ndarray:
    """Displacement (n, 3) [m] outwards that frees cloth of the skin in some poses, up to `MOST_ROOM`. rig: the body
    model's, which the avatar is bound to.

    Skin deeper than twice that is another limb's, which no room would help.
    """
    from scipy.spatial import cKDTree

    some = slice(None, None, max(1, len(bound.vertices) // MEASURED))
    lack = np.zeros(len(bound.vertices[some]))
    beneath, poses = _skin_near(avatar, bound.vertices), _poses(rig)
    for (positions, _), draped in zip(poses, drape_poses(bound, poses, precision="fp32")):
        bones = rig.bone_transforms(positions, heads=avatar.bone_heads)
        skin = SkinClearance(beneath.posed_vertices(bones), beneath.faces, POSED_POINTS)
        clearance, _ = skin(*np.split(draped[some].astype(np.float64), 2, axis=1))
        lack = np.maximum(lack, np.where(clearance > -2 * MOST_ROOM, CLEAR - clearance, 0))
    measured = cKDTree(bound.vertices[some])

    def shared(of_some: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance, near = measured.query(vertices, k=min(NEIGHBOURS, len(lack)))
        return np.exp(-((distance / RADIUS) ** 2)), of_some[near]

    closeness, lacking = shared(np.minimum(lack, MOST_ROOM), bound.vertices[some])
    closeness, room = shared((closeness * lacking).max(axis=1), bound.vertices)
    room = (closeness * room).sum(axis=1) / closeness.sum(axis=1)
    return room[:, None] * vertex_normals(bound.vertices, bound.faces)


def _poses(rig: Rig) -> list[tuple[np.ndarray, np.ndarray]]:
    """Joint positions (d,) [rad] and a gravity direction (3,) of each pose: everyday ones and wider ones."""
    random = np.random.default_rng(0)
    shape = WIDE_POSES, len(rig.rest)
    limit = np.where(random.random(shape) < 0.5, rig.lower, rig.upper)
    wide = rig.rest + WIDE_RANGE * random.random(shape) * (limit - rig.rest)
    positions, gravity = everyday_poses(rig)
    return [*zip(positions, gravity), *((pose.astype(np.float32), UPRIGHT_GRAVITY) for pose in wide)]


def _skin_near(avatar: Avatar, cloth: np.ndarray) -> Avatar:
    """The part of an avatar that is near cloth (n, 3) at rest; all of it, if none is."""
    from scipy.spatial import cKDTree

    near = np.isfinite(cKDTree(cloth).query(avatar.vertices, distance_upper_bound=NEAR_GARMENT)[0])
    kept = near[avatar.faces].all(axis=1)
    if not kept.any():
        return avatar
    used, faces = np.unique(avatar.faces[kept], return_inverse=True)
    return replace(
        avatar,
        vertices=avatar.vertices[used],
        faces=faces.reshape(-1, 3),
        influence_bones=avatar.influence_bones[used],
        influence_weights=avatar.influence_weights[used],
    )
