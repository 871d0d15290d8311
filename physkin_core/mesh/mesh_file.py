"""Garment files: reading a mesh with its look (UVs, materials, parts), and writing it as OBJ.

OBJ, GLB and glTF have all of it; of PLY, STL and OFF only the shape is read.
Dimensions: `n` vertices, `f` triangles.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from physkin_core.file_reading import ContentError, file_beside, read_bytes, read_text, reading, sentence
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_scene import drawn_primitives, in_scene
from physkin_core.formats.obj_file import read_obj
from physkin_core.formats.surface_file import read_surface
from physkin_core.mesh.gltf_look import gltf_look
from physkin_core.mesh.look import LIBRARY, Look
from physkin_core.model.garment import GarmentError

__all__ = ["SUFFIXES", "MeshFile", "read_mesh", "write_obj"]

log = logging.getLogger(__name__)

SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
SCENE_SUFFIXES = (".glb", ".gltf")
LONGEST_NAME = 1_024  # [characters]


@dataclass(frozen=True)
class MeshFile:
    """vertices (n, 3) in the file's frame and unit, faces (f, 3), how many of the file's faces had more than three
    corners, the look, and the vertices that line elements (k, 2) of an OBJ run between: creases and threads."""

    vertices: np.ndarray
    faces: np.ndarray
    polygons: int
    look: Look
    line_elements: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=int))


def read_mesh(path: Path) -> MeshFile:
    """All meshes of a garment file as one. Raises GarmentError when it holds none, or cannot be read."""
    suffix = path.suffix.lower()
    with reading(f"garment {path}", GarmentError):
        if suffix not in SUFFIXES:
            raise ContentError(f"the extension {path.suffix!r} is unknown; allowed: {', '.join(SUFFIXES)}")
        if suffix == ".obj":
            mesh = _read_obj(path)
        elif suffix in SCENE_SUFFIXES:
            mesh = _read_gltf(path)
        else:
            vertices, faces = read_surface(path)
            mesh = MeshFile(vertices, faces, 0, Look.plain(len(faces)))
        if len(mesh.faces) == 0:
            raise ContentError("it holds no faces")
    return mesh


def write_obj(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    look: Look,
    *,
    header: str,
    line_elements: Sequence[Sequence[int]] = (),
) -> None:
    """Write vertices (n, 3) and faces (f, 3) as OBJ, and the files of the look beside it. line_elements: (k, 2)."""
    lines = [f"# {header}"]
    if LIBRARY in look.files:
        lines.append(f"mtllib {LIBRARY}")
    lines += [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in vertices.tolist()]
    textured = np.isfinite(look.uv).all(axis=(1, 2))
    places, index = np.unique(np.round(look.uv[textured].reshape(-1, 2), 6), axis=0, return_inverse=True)
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in places.tolist()]
    texture = np.zeros(faces.shape, dtype=int)
    texture[textured] = index.reshape(-1, 3) + 1
    now = (-1, -1)
    for face in np.lexsort([look.material, look.part]):
        part, material = look.part[face], look.material[face]
        if part != now[0]:
            lines.append(f"o {look.parts[part]}")
        if material != now[1]:
            lines.append(f"usemtl {look.materials[material]}")
        now = (part, material)
        corners = zip((faces[face] + 1).tolist(), texture[face].tolist())
        lines.append("f " + " ".join(f"{vertex}/{uv}" if uv else f"{vertex}" for vertex, uv in corners))
    lines += [f"l {start + 1} {end + 1}" for start, end in line_elements]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for name, content in look.files.items():
        (path.parent / name).write_bytes(content)


def _read_obj(path: Path) -> MeshFile:
    file = read_obj(path)
    materials, material = _numbered([names.material for names in file.names], file.face_names)
    parts, part = _numbered([names.part for names in file.names], file.face_names)
    if len(parts) == 1:
        parts, part = (), np.full(len(part), -1)
    files = _library(path, file.libraries) if materials else {}
    look = Look(file.uv, material, part, materials, parts, files)
    return MeshFile(file.vertices, file.faces, file.polygons, look, file.line_elements)


def _numbered(names: Sequence[str], which: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Names, each once and none empty, and what faces have of them, by `which` (f,) of `names`; -1 for none."""
    number = {name: index for index, name in enumerate(dict.fromkeys(filter(None, names)))}
    return tuple(number), np.array([number.get(name, -1) for name in names], dtype=int)[which]


def _library(path: Path, names: Sequence[str]) -> dict[str, bytes]:
    """Material libraries that an OBJ names as one, and the pictures they name, all by their names alone.

    What is missing is left out. Raises ContentError where one is in another folder.
    """
    lines, pictures = [], {}
    for name in dict.fromkeys(names):
        if not os.path.isfile(path.parent / name):
            continue
        library = file_beside(path, name)
        for line in read_text(library).split("\n"):
            before, named = _named_picture(library.parent, line)
            if named:
                picture = file_beside(path, str(library.parent / named))
                if picture not in pictures:
                    pictures[picture] = read_bytes(picture)
                line = before + picture.name
            lines.append(line)
    files = {picture.name: content for picture, content in pictures.items()}
    return {LIBRARY: ("\n".join(lines) + "\n").encode(), **files} if lines else {}


def _named_picture(folder: Path, line: str) -> tuple[str, str]:
    """The picture that a line of a library names, empty for none, and what stands before its name: keyword and options.

    Options take words and any count of numbers, and file names have spaces: it is the longest end that is a file."""
    line = line.strip()
    if re.match(r"map_|bump|disp|norm", line):
        for gap in re.compile(r"\s+").finditer(line, max(0, len(line) - LONGEST_NAME)):
            if os.path.isfile(folder / line[gap.end() :]):
                return line[: gap.end()], line[gap.end() :]
    return line, ""


def _read_gltf(path: Path) -> MeshFile:
    """Where there are textures or several meshes, vertices at equal places are one."""
    file = GltfFile(path)
    drawn = list(drawn_primitives(file))
    if not drawn:
        raise ContentError("it holds no faces")
    look = gltf_look(file, drawn, lambda text: log.warning("%s", sentence(f"garment {path}: {text}")))
    names = [file.nodes[each.node].text("name") or f"node {each.node}" for each in drawn]
    parts, part = _numbered(names, np.repeat(np.arange(len(drawn)), [len(each.faces) for each in drawn]))
    ends = np.cumsum([0, *(len(each.positions) for each in drawn)])
    points = np.concatenate([in_scene(file, each.node, each.positions) for each in drawn])
    faces = np.concatenate([each.faces + start for each, start in zip(drawn, ends)])
    if len(drawn) > 1 or np.isfinite(look.uv).any():
        _, first, place = np.unique(points + 0.0, axis=0, return_index=True, return_inverse=True)
        points, faces = points[first], place.reshape(-1)[faces]
    if len(parts) == 1:
        parts, part = (), np.full(len(part), -1)
    return MeshFile(points, faces, 0, replace(look, part=part, parts=parts))
