"""Materials of a look: the faces that each covers, its colour and pictures; and texture coordinates one a vertex.

A texture has seams where cloth and skin have none. In files with one texture coordinate for each vertex, such vertices
are repeated and skinned alike, so that nothing opens.

Dimensions: `f` faces, `v` vertices, `w` of them with repetitions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from physkin_core.file_reading import shown
from physkin_core.mesh.finishing import Finish
from physkin_core.mesh.look import LIBRARY, Look, picture_kind

__all__ = [
    "Part",
    "Picture",
    "Surface",
    "parts_of",
    "readable",
    "split_at_seams",
    "surfaces_of",
]

ROUGHNESS = 0.9
"""Of cloth and skin, where a material says nothing."""


SHADING = {"Pr": "roughness", "Ps": "sheen"}
"""Keywords of a material library's extension for physically based rendering; so is `norm`."""
PICTURES = {"map_Kd": ("picture", "repeats"), "norm": ("normals", "normal_repeats")}


@dataclass(frozen=True)
class Picture:
    """A picture file. kind: its media type."""

    name: str
    content: bytes
    kind: str


@dataclass(frozen=True)
class Surface:
    """A material. colour: (3,) linear RGB in [0, 1], which multiplies the picture's. faces: (k,) those that have it.
    repeats: how often the picture is repeated in a unit of either texture coordinate (a metre on a garment that was cut
    flat), from the origin on. normals: picture of normals in the frame of the texture, green upwards, with repeats of
    its own. roughness, sheen: from 0 to 1, as in glTF. blended: by the picture's opacity."""

    name: str
    colour: tuple[float, ...]
    faces: np.ndarray
    picture: Picture | None = None
    repeats: tuple[float, float] = (1.0, 1.0)
    normals: Picture | None = None
    normal_repeats: tuple[float, float] = (1.0, 1.0)
    roughness: float = ROUGHNESS
    sheen: float = 0.0
    blended: bool = False


@dataclass(frozen=True)
class Part:
    """What a file has as one mesh: a mesh with its look, or what finishes it, on vertices of its own. faces: (k, 3)."""

    name: str
    faces: np.ndarray
    look: Look | None
    surfaces: Sequence[Surface]
    finish: Finish | None = None

    def on(self, cloud: np.ndarray) -> np.ndarray:
        """(w, 6) positions and normals of its vertices. cloud: the mesh's."""
        return cloud if self.finish is None else self.finish.on(cloud)


def parts_of(look: Look | None, name: str, colour: tuple[float, float, float], faces: np.ndarray) -> list[Part]:
    """A mesh and what finishes it. name, colour: sRGB, of faces (f, 3) without a material, or all without a look."""
    found = [Part(name, faces, look, surfaces_of(look, name, colour, len(faces)))]
    for k, (finish, surface) in enumerate(() if look is None else look.finishes):
        whole = replace(surface, faces=np.arange(len(finish.faces)))
        found.append(Part(f"{name}_finish_{k}", finish.faces, Look.with_places(finish.places), [whole], finish))
    return found


def surfaces_of(look: Look | None, name: str, colour: tuple[float, float, float], count: int) -> list[Surface]:
    """Materials that cover a mesh's `count` faces. name, colour: sRGB, of faces without one, or all without a look."""
    linear = tuple(float(channel) ** 2.2 for channel in colour)
    material = np.full(count, -1) if look is None else look.material
    library = {} if look is None else _materials(look)
    found = []
    for index in np.unique(material):
        faces = np.flatnonzero(material == index)
        own = Surface(name, linear, faces) if index < 0 else library[look.materials[index]]
        found.append(replace(own, faces=faces))
    return found


def readable(look: Look, warn: Callable[[str], None]) -> Look:
    """The look without those lines of its material library that `surfaces_of` would refuse. warn: gets reasons."""
    kept = []
    for material, word, rest, line in _library_lines(look):
        try:
            _said(look, material, word, rest)
            kept.append(line)
        except ValueError as error:
            warn(str(error))
    return replace(look, files={**look.files, LIBRARY: b"".join(kept)})


def split_at_seams(look: Look, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One texture coordinate a vertex: which vertex each is (w,), its place (w, 2) with the origin at the lower left, 0
    where there is none, and faces (f, 3) of these."""
    corners = np.column_stack([faces.reshape(-1), np.nan_to_num(look.uv).reshape(-1, 2).round(6)])
    unique, split = np.unique(corners, axis=0, return_inverse=True)
    return unique[:, 0].astype(np.int32), unique[:, 1:], split.reshape(faces.shape)


def _materials(look: Look) -> dict[str, Surface]:
    """Each material named, from the material library, of no faces yet; white where that says nothing."""
    found = {name: Surface(name, (1.0, 1.0, 1.0), np.empty(0, dtype=int)) for name in look.materials}
    for material, word, rest, _ in _library_lines(look):
        if material:
            found[material] = replace(found[material], **_said(look, material, word, rest))
    return found


def _library_lines(look: Look) -> Iterator[tuple[str, str, str, bytes]]:
    """Of each line: the material that it is about, empty for one of no face; keyword and what follows it; the line."""
    material = ""
    for line in look.files.get(LIBRARY, b"").splitlines(keepends=True):
        word, rest = [*line.decode("utf-8", "replace").split(None, 1), "", ""][:2]
        if word == "newmtl":
            name = " ".join(rest.split())  # as `usemtl` is read
            material = name if name in look.materials else ""
        yield material, word, rest, line


def _said(look: Look, material: str, word: str, rest: str) -> dict[str, Any]:
    """What a line says of a material, as fields of a `Surface`. Raises ValueError for what cannot be."""
    if not material:
        return {}
    if word == "Kd":
        return {"colour": _shares(material, "colour Kd", rest, 3)}
    if word in SHADING:
        return {SHADING[word]: _shares(material, f"{SHADING[word]} {word}", rest, 1)[0]}
    if word in PICTURES:
        picture, options = _picture(look, material, rest)
        return dict(zip(PICTURES[word], (picture, _repeats(material, options))))
    return {}


def _shares(material: str, what: str, text: str, count: int) -> tuple[float, ...]:
    """One number or three from 0 to 1. text: what follows the keyword."""
    try:
        shares = tuple(float(value) for value in text.split()[:count])
    except ValueError:
        shares = ()
    if len(shares) != count or not all(0 <= share <= 1 for share in shares):
        numbers = "three numbers" if count > 1 else "a number"
        raise ValueError(
            f"the {what} of material {shown(material)} must be {numbers} from 0 to 1, got {shown(text.strip())}"
        )
    return shares


def _picture(look: Look, material: str, named: str) -> tuple[Picture, str]:
    """named: what follows the keyword, a file name after options. Returns the options, too."""
    text = " " + " ".join(named.split())
    names = {each: " " + " ".join(each.split()) for each in look.files}
    name = max((each for each in names if text.endswith(names[each])), key=len, default=None)
    if name is None:
        raise ValueError(f"the picture of material {shown(material)} is missing: {shown(named.strip())}")
    content = look.files[name]
    kind = picture_kind(content)
    if kind is None:
        raise ValueError(f"the picture of material {shown(material)}, {shown(name)}, must be PNG or JPEG")
    return Picture(name, content, kind), text.removesuffix(names[name])


def _repeats(material: str, options: str) -> tuple[float, float]:
    """By the option `-s u v w`, whose last numbers may be left out."""
    found = re.search(r"(?:^|\s)-s((?:\s+[-+]?\.?\d\S*){0,3})(?=\s|$)", options)
    if found is None:
        return 1.0, 1.0
    try:
        u, v = [*map(float, found[1].split()[:2]), 1.0][:2]
    except ValueError:
        u = v = 0.0
    if not found[1] or not all(math.isfinite(scale) and scale for scale in (u, v)):
        raise ValueError(
            f"the scale -s of material {shown(material)} must be one to three numbers other than 0, got "
            f"{shown(found[1].strip())}"
        )
    return u, v
