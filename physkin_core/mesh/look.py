"""What a mesh has besides its shape, as an OBJ's material library holds it.

Dimensions: `n` vertices, `f` triangles, `k` colours.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from physkin_core.mesh.finishing import Finish
from physkin_core.quality import closest_points

if TYPE_CHECKING:
    from physkin_core.mesh.surfaces import Surface

__all__ = ["LIBRARY", "Look", "MaterialLibrary", "few_colours", "picture_kind"]

LIBRARY = "garment.mtl"
PICTURE_KINDS = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
"""Beginnings of the pictures that glTF and USD both take."""
ROUNDS = 20
"""Of k-means, to find few colours that stand for many."""


@dataclass(frozen=True)
class Look:
    """What a mesh has besides its shape. uv: (f, 3, 2) of each corner, NaN for none, origin at the lower left.

    material, part: (f,) indices into `materials` and `parts`, names; -1 for none. files: by name what is written beside
    the mesh, the material library and its pictures. finishes: stitches and hems, each with its material.
    """

    uv: np.ndarray
    material: np.ndarray
    part: np.ndarray
    materials: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    files: dict[str, bytes] = field(default_factory=dict)
    finishes: tuple[tuple[Finish, Surface], ...] = ()

    @classmethod
    def plain(cls, f: int) -> Look:
        """Of a mesh of shape alone."""
        return cls(np.full((f, 3, 2), np.nan), np.full(f, -1), np.full(f, -1))

    @classmethod
    def with_places(cls, uv: np.ndarray) -> Look:
        """Of a mesh that has texture coordinates (f, 3, 2) alone."""
        return replace(cls.plain(len(uv)), uv=uv)

    def on(self, source: tuple[np.ndarray, np.ndarray], vertices: np.ndarray, faces: np.ndarray) -> Look:
        """The look of another mesh of the same surface: each face has that of the closest face of the source's vertices
        and faces, wherever cut, turned over or welded."""
        from trimesh.triangles import points_to_barycentric

        corners = vertices[faces]
        _, closest, _ = closest_points(corners.mean(axis=1), *source)
        triangles = source[0][source[1][closest]]
        flat = np.repeat(triangles, 3, axis=0)
        shares = points_to_barycentric(flat, corners.reshape(-1, 3)).reshape(-1, 3, 3)
        uv = np.einsum("fck,fku->fcu", shares, self.uv[closest])
        return Look(uv, self.material[closest], self.part[closest], self.materials, self.parts, self.files)

    def of_corners(self, corners: np.ndarray) -> Look:
        """The look of faces by the numbers (f, 3) of their corners here, three a face, some left out or turned over;
        without finishes."""
        face = corners[:, 0] // 3
        uv = self.uv.reshape(-1, 2)[corners]
        return Look(uv, self.material[face], self.part[face], self.materials, self.parts, self.files)

    def of_faces(self, chosen: np.ndarray, faces: np.ndarray) -> Look:
        """The look of some of the mesh's faces (f, 3), a mask (f,), and of the vertices that these use."""
        own = self.of_corners(np.arange(faces.size).reshape(-1, 3)[chosen])
        finishes = [(finish.of_faces(chosen, faces), surface) for finish, surface in self.finishes]
        return replace(own, finishes=tuple(each for each in finishes if len(each[0].faces)))

    def __str__(self) -> str:
        """What there is, in words."""
        has_uv = np.isfinite(self.uv).all(axis=(1, 2)).any()
        named = {"materials": self.materials, "parts": self.parts}
        return ", ".join(
            (["UVs"] if has_uv else []) + [f"{len(names)} {word}" for word, names in named.items() if names]
        )


class MaterialLibrary:
    """Materials as a material library while it grows: `names`, `files` as in `Look`."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.files: dict[str, bytes] = {}

    @staticmethod
    def plain_name(name: str) -> str:
        """A name in letters, digits, underscores, points and dashes, which is that of a file, too."""
        return re.sub(r"[^\w.-]+", "_", name)

    def add(self, name: str, colour: Sequence[float], picture: bytes | None) -> int:
        """Its number in `names`. name: plain, and new. colour: linear RGB. picture: a PNG or JPEG."""
        self.names.append(name)
        text = f"newmtl {name}\nKd " + " ".join(f"{value:.4f}" for value in colour) + "\n"
        if picture is not None:
            file = f"{name}.{'jpg' if picture_kind(picture) == 'image/jpeg' else 'png'}"
            self.files[file] = picture
            text += f"map_Kd {file}\n"
        self.files[LIBRARY] = self.files.get(LIBRARY, b"") + text.encode()
        return len(self.names) - 1


def picture_kind(content: bytes) -> str | None:
    """Media type of a picture file; None for neither PNG nor JPEG."""
    return next((kind for start, kind in PICTURE_KINDS.items() if content.startswith(start)), None)


def few_colours(colours: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """At most so many colours that stand for those of faces (f, 3): (k, 3), and which (f,) each face has."""
    from scipy.cluster.vq import kmeans2

    different, index = np.unique(colours.round(2), axis=0, return_inverse=True)
    if len(different) <= most:
        return different, index.reshape(-1)
    centres, nearest = kmeans2(colours, most, iter=ROUNDS, minit="++", rng=0)
    used, index = np.unique(nearest, return_inverse=True)
    return centres[used], index.reshape(-1)
