"""What an outfit covers: cloth and skin that nobody sees in everyday poses need not be computed or drawn, and skin
under cloth may be drawn slimmer.

A point is covered where the closest cloth that faces alike is not near that cloth's hem: an opening shows what lies
under it as deep as it gapes. Conservative: it must hold in every pose looked at.

Dimensions: `n` garment vertices, `f` faces, `k` points. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import face_areas, vertex_normals
from physkin_core.model.surface_paths import HEM, hem_distances
from physkin_core.outfit.tuck import DEEP, SLIDES
from physkin_core.runtime.layer import Layer

__all__ = [
    *("OWN_CLOTHES", "AlwaysCovered", "Cover", "OwnClothes", "covered", "covers_of", "faces_of", "own_clothes_beside"),
    "slimmed",
]

FLARE = 1.5
"""How much longer the way to a hem is along cloth that flares or is folded than straight: by less, a circle skirt would
cover ankles that are below it."""
STANDS_OUT = 0.05
"""[m] A point farther outside its cover than this does not belong to it."""
SLIMMER = 0.006
"""[m] How much slimmer skin is drawn under cloth."""
SLIMMING = (-0.03, 0.0)
"""[m] behind a hem, where that begins, on bare skin, and where it is reached: hems slide."""
REPLACED = 0.5
"""Share of a piece of an avatar's own clothes under garments from which these replace it."""
OwnClothes = Literal["replace", "hide", "keep"]
OWN_CLOTHES: tuple[OwnClothes, ...] = get_args(OwnClothes)
"""What becomes of clothes that an avatar wears already: gone where garments replace them, all gone, or all kept."""
SLIMMEST = 0.15
"""But by no more than this share of the way to its bone: wrists are seen in wide cuffs."""


@dataclass(frozen=True)
class Cover:
    """A garment in a pose. vertices, normals: (n, 3). hem_distance: (n,) [m] along the cloth to its closest opening."""

    vertices: np.ndarray
    normals: np.ndarray
    hem_distance: np.ndarray


class AlwaysCovered:
    """What layers cover in every pose looked at: until the first one, everything.

    cloth: a mask (n,) of each layer; of what is tucked in, also what nobody sees so far below a waistband. body: one of
    the avatar's vertices (V,).
    """

    def __init__(self, layers: Sequence[Layer], avatar: Avatar) -> None:
        self.body = np.ones(len(avatar.vertices), dtype=bool)
        self._layers, self._avatar = layers, avatar
        self._covered = [np.ones(len(layer.rest), dtype=bool) for layer in layers]

    @property
    def cloth(self) -> list[np.ndarray]:
        """See above."""
        return [mask | (layer.tucked_depth > DEEP) for layer, mask in zip(self._layers, self._covered)]

    def look(self, joint_positions: np.ndarray, drawn: Sequence[np.ndarray]) -> None:
        """Look at one more pose. joint_positions: (d,) [rad]. drawn: the whole layers in it, (n, 6) each."""
        drawn = [layer.astype(np.float64) for layer in drawn]
        covers = covers_of(self._layers, drawn)
        bones = self._layers[0].model.rig.bone_transforms(joint_positions, heads=self._avatar.bone_heads)
        skin = self._avatar.posed_vertices(bones).astype(np.float64)
        skin = np.concatenate([skin, vertex_normals(skin, self._avatar.faces)], axis=1)
        over = [_over(layer, covers[k + 1 :]) for k, layer in enumerate(self._layers)]
        for mask, points, above in zip([self.body, *self._covered], [skin, *drawn], [covers, *over]):
            left = np.flatnonzero(mask)
            mask[left] = covered(points[left, :3], points[left, 3:], above)


def covers_of(layers: Sequence[Layer], drawn: Sequence[np.ndarray]) -> list[Cover]:
    """Layers as they are drawn in a pose, (n, 6) each."""
    return [Cover(d[:, :3], d[:, 3:], layer.hem_distance) for layer, d in zip(layers, drawn)]


def _over(layer: Layer, covers: Sequence[Cover]) -> list[Cover]:
    """What covers a layer. A tucked one may slide up, so that more of it, below a waistband, counts as near that."""
    slides = SLIDES if layer.tucked else 0
    return [replace(cover, hem_distance=cover.hem_distance - slides) for cover in covers]


def covered(points: np.ndarray, normals: np.ndarray, covers: Sequence[Cover]) -> np.ndarray:
    """Which of points (k, 3) with outward normals (k, 3) are under one of the covers: (k,) bool."""
    under = np.zeros(len(points), dtype=bool)
    for cover in covers:
        left = np.flatnonzero(~under)
        under[left] = _depths(points[left], normals[left], cover) >= HEM
    return under


def own_clothes_beside(avatar: Avatar, layers: Sequence[Layer], own_clothes: OwnClothes) -> tuple[Avatar, ...]:
    """What an avatar still wears beside layers: of its own clothes those that are not replaced, without what is
    covered at rest."""
    if own_clothes == "hide" or not avatar.clothes:
        return ()
    left, covers = [], covers_of(layers, [layer.rest for layer in layers])
    for piece in avatar.clothes:
        normals, areas = vertex_normals(piece.vertices, piece.faces), face_areas(piece.vertices, piece.faces)
        under = np.max([_depths(piece.vertices, normals, cover) for cover in covers], axis=0) > 0
        seen = ~faces_of(piece.faces, under)
        if seen.any() and (own_clothes == "keep" or areas[seen].sum() > (1 - REPLACED) * areas.sum()):
            left.append(replace(piece, faces=piece.faces[seen], file_corners=piece.file_corners[seen]))
    return tuple(left)


def slimmed(avatar: Avatar, covers: Sequence[Cover]) -> Avatar:
    """The avatar as it is drawn under covers and its own clothes at rest: skin under cloth up to 6 mm slimmer, so that
    it does not show through where cloth lies a millimetre too deep."""
    normals = vertex_normals(avatar.vertices, avatar.faces)
    covers = [*covers, *map(_cover_of, avatar.clothes)]
    depth = np.max([_depths(avatar.vertices, normals, cover) for cover in covers], axis=0)
    slimmer = np.minimum(SLIMMER, SLIMMEST * _to_bones(avatar)) * np.interp(depth, SLIMMING, (0, 1))
    return replace(avatar, vertices=(avatar.vertices - slimmer[:, None] * normals).astype(np.float32))


def _cover_of(piece: Avatar) -> Cover:
    """A piece of the avatar's own clothes at rest."""
    vertices, faces = piece.vertices, piece.faces
    within = np.minimum(hem_distances(vertices, faces), STANDS_OUT)  # closed pieces have no hem
    return Cover(vertices, vertex_normals(vertices, faces), within)


def _to_bones(avatar: Avatar) -> np.ndarray:
    """Distance (V,) [m] of vertices from the bone that moves them most."""
    bone = np.take_along_axis(avatar.influence_bones, avatar.influence_weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    along, gap = (avatar.bone_tails - avatar.bone_heads)[bone], avatar.vertices - avatar.bone_heads[bone]
    share = (along * gap).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-12)
    return np.linalg.norm(gap - np.clip(share, 0, 1)[:, None] * along, axis=1)


def _depths(points: np.ndarray, normals: np.ndarray, cover: Cover) -> np.ndarray:
    """How far (k,) [m] behind the cover's hem points (k, 3) with normals (k, 3) are, less `FLARE` times their distance
    from it; minus infinity where they are not under it."""
    from scipy.spatial import cKDTree

    match = cKDTree(with_normals(cover.vertices, cover.normals)).query(with_normals(points, normals))[1]
    gap = cover.vertices[match] - points
    height = np.einsum("ki,ki->k", gap, normals)
    alike = np.einsum("ki,ki->k", cover.normals[match], normals) > 0
    depth = cover.hem_distance[match] - FLARE * np.linalg.norm(gap, axis=1)
    return np.where(alike & (height > -STANDS_OUT), depth, -np.inf)


def faces_of(faces: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """(f,) bool: faces (f, 3) all of whose corners are hidden (n,)."""
    return hidden[faces].all(axis=1)
