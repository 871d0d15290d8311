"""Wavefront OBJ: shape, texture coordinates and what faces are called, for garments, bodies and points alike.

Other readers split vertices at texture seams, or reorder them by material. Dimensions: `n` vertices, `f` triangles.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from physkin_core.file_reading import ContentError, read_text, shown, with_decimal_points

__all__ = ["FaceNames", "ObjFile", "read_obj"]

NAMING = {"usemtl": ("material",), "g": ("group", "part"), "o": ("object", "part")}
"""Keyword -> the names that it sets."""


class FaceNames(NamedTuple):
    """What a face belongs to, empty for none. part: its group or object, whichever was named last."""

    material: str = ""
    group: str = ""
    object: str = ""
    part: str = ""


@dataclass(frozen=True)
class ObjFile:
    """vertices: (n, 3) in the order, frame and unit of the file. faces: (f, 3); larger ones, `polygons` of them, are
    cut into fans. uv: (f, 3, 2) of each corner, NaN for none. names: what faces are called, each once; face_names: (f,)
    indices into them. libraries: material libraries, as they are named. line_elements: (k, 2) vertices that lines run
    between, those of more corners cut into pieces. lines: all of the file, continued ones joined.
    """

    vertices: np.ndarray
    faces: np.ndarray
    polygons: int
    uv: np.ndarray
    names: tuple[FaceNames, ...]
    face_names: np.ndarray
    libraries: tuple[str, ...]
    line_elements: np.ndarray
    lines: tuple[str, ...]

    def write(self, path: Path, vertices: np.ndarray) -> None:
        """Write the file with other vertices (n, 3). Normals are left out, which readers make anew."""
        written, places = [], iter(vertices.tolist())
        for line in self.lines:
            kind, *entries = _words(line)
            if kind == "v":
                numbers = " ".join(f"{value:.7g}" for value in next(places))
                line = " ".join(["v", numbers, *entries[3:]])  # colours
            elif kind == "f":
                line = " ".join(["f", *("/".join(entry.split("/")[:2]).rstrip("/") for entry in entries)])
            if kind != "vn":
                written.append(line)
        path.write_text("\n".join(written) + "\n", encoding="utf-8")


def read_obj(path: Path) -> ObjFile:
    """Read a file. Raises OSError where it cannot be opened, ContentError for lines that are not as the format has
    them, and for faces and line elements at vertices or texture coordinates that are not there."""
    lines = tuple(read_text(path).replace("\\\n", " ").removesuffix("\n").split("\n"))
    vertices, places, faces, uv, face_names, libraries = [], [[np.nan, np.nan]], [], [], [], []
    line_elements: list[tuple[int, int]] = []
    now, names, polygons = FaceNames(), {}, 0
    known: dict[str, tuple[int, int]] = {}
    for line in lines:
        kind, *entries = _words(line)
        if kind == "v":
            vertices.append(_numbers(line, entries[:3], 3))
        elif kind == "vt":
            places.append(_numbers(line, [*entries[:2], "0"][:2], 2))
        elif kind in NAMING:
            now = now._replace(**dict.fromkeys(NAMING[kind], " ".join(entries)))
        elif kind == "mtllib":
            libraries.append(" ".join(entries))
        elif kind == "l":
            ends = [_corner(line, entry, len(vertices), len(places))[0] for entry in entries]
            line_elements += zip(ends, ends[1:])
        elif kind == "f":
            polygons += len(entries) > 3
            corners = []
            for entry in entries:
                corner = known.get(entry)
                if corner is None:
                    corner = _corner(line, entry, len(vertices), len(places))
                    if "-" not in entry:  # which counts back from where it stands
                        known[entry] = corner
                corners.append(corner)
            for pair in zip(corners[1:], corners[2:]):
                vertex, place = zip(corners[0], *pair)
                faces.append(vertex)
                uv.append(place)
                face_names.append(names.setdefault(now, len(names)))
    corners, places = np.array(faces, dtype=int).reshape(-1, 3), np.array(places)
    uv, ends = np.array(uv, dtype=int).reshape(-1, 3), np.array(line_elements, dtype=int).reshape(-1, 2)
    for element, found, count, what in (
        ("face", corners, len(vertices), "vertices"),
        ("face", uv, len(places), "texture coordinates"),
        ("line", ends, len(vertices), "vertices"),
    ):
        if len(found) and not (0 <= found.min() and found.max() < count):
            raise ContentError(f"a {element} has corners at {what} that do not exist; there are {count}")
    named = np.array(face_names, dtype=int)
    shape = np.array(vertices, dtype=float).reshape(-1, 3), corners
    return ObjFile(*shape, polygons, places[uv], tuple(names), named, tuple(libraries), ends, lines)


def _words(line: str) -> list[str]:
    """Keyword and entries of a line, without a comment; one empty word for none."""
    return line.partition(" #")[0].split() or [""]


def _numbers(line: str, entries: list[str], count: int) -> list[float]:
    if "," in line:
        entries = _words(with_decimal_points(line))[1 : count + 1]
    with suppress(ValueError):
        if len(entries) == count:
            return [float(entry) for entry in entries]
    raise ContentError(f"{shown(line.strip())} must have {count} numbers")


def _corner(line: str, entry: str, vertices: int, places: int) -> tuple[int, int]:
    """Vertex, from 0, and texture coordinate, from 1, 0 for none, of an entry of a face so far into the file."""
    try:
        vertex, place = (int(number or 0) for number in [*entry.split("/"), ""][:2])
    except ValueError:
        raise ContentError(f"{shown(line.strip())}: {shown(entry)} is no corner") from None
    return vertex - 1 if vertex > 0 else vertices + vertex if vertex else -1, place if place >= 0 else places + place
