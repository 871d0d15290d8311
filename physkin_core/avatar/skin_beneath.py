"""Skin for an avatar that was modelled dressed: where its clothes are all there is, the body model stands in beneath.

Garments are then made to measure for a body and kept clear of its skin, not of a sleeve that sticks out; and what is
worn already can be taken off without a hole.

Dimensions: `V` vertices of the body model, `f` its faces. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physkin_core.avatar.avatar import Avatar, joined_surfaces
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.avatar.body_parts import free_bones
from physkin_core.avatar.shape_fitting import lay_beneath
from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import face_areas, vertex_normals
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.rig.linear_blend_skinning import strongest_influence

__all__ = ["with_skin_beneath"]

POINTS = 24576
"""Points sampled on each surface."""
BARE = 0.02
"""[m] The body model farther than this from skin that faces alike has none."""
OVERLAP = 0.04
"""[m] The body model reaches so far beneath skin."""
WORN = 0.12
"""[m] Clothes so near are worn there."""
BENEATH_CLOTHES, BENEATH_SKIN = 0.004, 0.001
"""[m] The body model stands in so much beneath clothes, and beneath the edge of skin that it joins."""
FARTHEST, FADING = 0.02, 0.05
"""[m] The most that it is moved for that, and how far from skin less and less."""
LEAST = 0.01
"""Share of the body without skin from which that is no accident."""


def with_skin_beneath(skin: Avatar, clothes: Sequence[Avatar]) -> Avatar:
    """The avatar with the body model's skin where there are clothes only; itself, where it has its own or is bound to
    another rig. A warning says how much there is of it."""
    body = load_body_model()
    if skin.bone_names != body.rig.bone_names or not clothes:
        return skin
    surface = lay_beneath(skin, clothes, body).surface
    normals = vertex_normals(surface, body.faces)
    off_skin, from_skin = _gaps(surface, normals, [skin])
    off_clothes, from_clothes = _gaps(surface, normals, clothes)
    lacking = (from_skin > BARE) & (from_clothes < WORN) & ~_free_vertices(body)
    areas = face_areas(surface, body.faces)
    chosen = _near(surface, lacking)[body.faces].any(axis=1)
    if areas[chosen].sum() < LEAST * areas.sum():
        return skin
    off = _carried_on(surface, off_skin - BENEATH_SKIN, from_skin < BARE)
    off = np.minimum(off, np.where(from_clothes < WORN, off_clothes - BENEATH_CLOTHES, np.inf))
    surface = surface + np.clip(off, -FARTHEST, FARTHEST)[:, None] * normals
    used, faces = np.unique(body.faces[chosen], return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    stand_in = replace(
        skin,
        vertices=surface[used].astype(np.float32),
        faces=faces,
        influence_bones=body.influence_bones[used],
        influence_weights=body.influence_weights[used],
        file_corners=_corner_of_nearest(skin, surface[body.faces[chosen]].mean(axis=1)),
    )
    share = 100 * areas[chosen].sum() / areas.sum()
    said = f"{share:.0f} % of the body has clothes and no skin: the body model's stands in beneath them"
    return replace(joined_surfaces([skin, stand_in]), warnings=(*skin.warnings, said))


def _gaps(vertices: np.ndarray, normals: np.ndarray, surfaces: Sequence[Avatar]) -> tuple[np.ndarray, np.ndarray]:
    """From vertices (V, 3) with normals (V, 3) to the closest point of surfaces that faces alike: along its normal,
    positive outwards, and in all (V,) [m]."""
    from scipy.spatial import cKDTree

    points = np.concatenate([with_normals(*sample_surface(each.vertices, each.faces, POINTS)) for each in surfaces])
    near = points[cKDTree(points).query(with_normals(vertices, normals))[1]]
    gap = near[:, :3] - vertices
    outward = near[:, 3:] / np.linalg.norm(near[:, 3:], axis=1, keepdims=True)
    alike = (outward * normals).sum(axis=1) > 0
    return (gap * outward).sum(axis=1), np.where(alike, np.linalg.norm(gap, axis=1), np.inf)


def _carried_on(surface: np.ndarray, off: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(V,) [m] distances where they are known, a mask (V,); elsewhere those of the closest such vertex, fading."""
    from scipy.spatial import cKDTree

    if not known.any():
        return np.zeros(len(surface))
    distance, nearest = cKDTree(surface[known]).query(surface)
    return np.exp(-((distance / FADING) ** 2)) * off[known][nearest]


def _near(surface: np.ndarray, lacking: np.ndarray) -> np.ndarray:
    """(V,) bool: vertices that have no skin, a mask (V,), and those around them, where both overlap."""
    from scipy.spatial import cKDTree

    if not lacking.any():
        return lacking
    return cKDTree(surface[lacking]).query(surface, distance_upper_bound=OVERLAP)[0] < OVERLAP


def _free_vertices(body: BodyModel) -> np.ndarray:
    """(V,) bool: of head, hands and feet, which garments leave free."""
    return free_bones(body.rig)[strongest_influence(body.influence_bones, body.influence_weights)]


def _corner_of_nearest(skin: Avatar, centres: np.ndarray) -> np.ndarray:
    """(k, 3) for each of faces with centres (k, 3) a corner of the closest face of the skin, thrice: its colour."""
    from scipy.spatial import cKDTree

    nearest = cKDTree(skin.vertices[skin.faces].mean(axis=1)).query(centres)[1]
    return np.repeat(skin.file_corners[nearest, :1], 3, axis=1)
