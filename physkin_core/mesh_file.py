"""Garment files: reading a mesh with its look (UVs, materials, parts), and writing it as OBJ.

OBJ, GLB and glTF have all of it; of PLY, STL and OFF only the shape is read.
Dimensions: `n` vertices, `f` triangles.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from physkin_core.model.garment import GarmentError
from physkin_core.obj_file import read_obj
from physkin_core.quality import closest_points

if TYPE_CHECKING:
    from trimesh.visual.material import PBRMaterial

__all__ = ["LIBRARY", "SUFFIXES", "Look", "MaterialLibrary", "MeshFile", "read_mesh", "write_obj"]

SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
SCENE_SUFFIXES = (".glb", ".gltf")
LIBRARY = "garment.mtl"


@dataclass(frozen=True)
class Look:
    """What a mesh has besides its shape. uv: (f, 3, 2) of each corner, NaN for none, origin at the lower left.

    material, part: (f,) indices into `materials` and `parts`, names; -1 for none. files: by name what is written beside
    the mesh, the material library and its pictures.
    """

    uv: np.ndarray
    material: np.ndarray
    part: np.ndarray
    materials: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    files: dict[str, bytes] = field(default_factory=dict)

    @classmethod
    def plain(cls, f: int) -> Look:
        """Of a mesh of shape alone."""
        return cls(np.full((f, 3, 2), np.nan), np.full(f, -1), np.full(f, -1))

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
        """The look of faces by the numbers (f, 3) of their corners here, three a face, some left out or turned over."""
        face = corners[:, 0] // 3
        uv = self.uv.reshape(-1, 2)[corners]
        return Look(uv, self.material[face], self.part[face], self.materials, self.parts, self.files)

    def __str__(self) -> str:
        """What there is, in words."""
        has_uv = np.isfinite(self.uv).all(axis=(1, 2)).any()
        named = {"materials": self.materials, "parts": self.parts}
        return ", ".join(
            (["UVs"] if has_uv else []) + [f"{len(names)} {word}" for word, names in named.items() if names]
        )


@dataclass(frozen=True)
class MeshFile:
    """vertices (n, 3) in the file's frame and unit, faces (f, 3), how many of the file's faces had more than three
    corners, and the look."""

    vertices: np.ndarray
    faces: np.ndarray
    polygons: int
    look: Look


def read_mesh(path: Path) -> MeshFile:
    """All meshes of a garment file as one. Raises GarmentError when it holds none, ModuleNotFoundError where texture
    places of a GLB or glTF need pillow."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise GarmentError(f"garment {path} has the unknown extension {path.suffix!r}; allowed: {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise GarmentError(f"garment {path}: no such file")
    try:
        mesh = _read_obj(path) if suffix == ".obj" else _read_scene(path)
    except ModuleNotFoundError:
        raise
    except Exception as error:  # whatever the parser trips over, the file is not a readable mesh
        raise GarmentError(f"cannot read garment mesh {path}: {error}") from error
    if len(mesh.faces) == 0:
        raise GarmentError(f"garment {path} holds no faces")
    return mesh


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray, look: Look, *, header: str) -> None:
    """Write vertices (n, 3) and faces (f, 3) as OBJ, and the files of the look beside it."""
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
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for name, content in look.files.items():
        (path.parent / name).write_bytes(content)


def _read_obj(path: Path) -> MeshFile:
    file = read_obj(path)
    materials, material = _numbered([names.material for names in file.names], file.face_names)
    parts, part = _numbered([names.part for names in file.names], file.face_names)
    if len(parts) == 1:
        parts, part = (), np.full(len(part), -1)
    files = _library(path.parent, file.libraries) if materials else {}
    look = Look(file.uv, material, part, materials, parts, files)
    return MeshFile(file.vertices, file.faces, file.polygons, look)


def _numbered(names: Sequence[str], which: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Names, each once and none empty, and what faces have of them, by `which` (f,) of `names`; -1 for none."""
    different = tuple(dict.fromkeys(filter(None, names)))
    return different, np.array([different.index(name) if name else -1 for name in names], dtype=int)[which]


def _library(folder: Path, names: Sequence[str]) -> dict[str, bytes]:
    """Material libraries of a folder as one, and the pictures they name, all by their names alone."""
    files, lines = {}, []
    for name in names:
        if not (folder / name).is_file():
            continue
        for line in (folder / name).read_text(encoding="utf-8", errors="replace").splitlines():
            before, picture = _named_picture(folder, line)
            if picture is not None:
                files[picture.name] = picture.read_bytes()
                line = before + picture.name
            lines.append(line)
    return {LIBRARY: ("\n".join(lines) + "\n").encode(), **files} if lines else {}


def _named_picture(folder: Path, line: str) -> tuple[str, Path | None]:
    """The picture that a line of a library names, None for none, and what stands before its name: keyword and options.

    Options take words and any count of numbers, and file names have spaces: it is the longest end that is a file."""
    line = line.strip()
    if re.match(r"map_|bump|disp|norm", line):
        for gap in re.finditer(r"\s+", line):
            picture = folder / line[gap.end() :]
            if picture.is_file():
                return line[: gap.end()], picture
    return line, None


def _read_scene(path: Path) -> MeshFile:
    """What trimesh reads; where there are textures or several meshes, vertices at equal places are one."""
    import trimesh

    scene = trimesh.load_scene(path, process=False)
    vertices, faces, uv, looks, parts, count = [], [], [], [], [], 0
    library = MaterialLibrary()
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        vertices.append(trimesh.transform_points(mesh.vertices, transform))
        corners = np.asarray(mesh.faces)[:, :: -1 if np.linalg.det(transform[:3, :3]) < 0 else 1]
        places = getattr(mesh.visual, "uv", None)
        if places is not None and path.suffix.lower() in SCENE_SUFFIXES:
            import PIL.Image  # noqa: F401 (where it is missing, trimesh leaves pictures out without a word)
        uv.append(np.full((len(corners), 3, 2), np.nan) if places is None else np.asarray(places)[corners])
        material = getattr(mesh.visual, "material", None) if path.suffix.lower() in SCENE_SUFFIXES else None
        looks.append(np.tile([_add_material(library, material), len(parts)], (len(corners), 1)))
        parts.append(str(node))
        faces.append(corners + count)
        count += len(mesh.vertices)
    material, part = np.concatenate(looks).T
    points, faces, uv = np.concatenate(vertices), np.concatenate(faces), np.concatenate(uv)
    if len(parts) > 1 or np.isfinite(uv).any():
        _, first, place = np.unique(points + 0.0, axis=0, return_index=True, return_inverse=True)
        points, faces = points[first], place.reshape(-1)[faces]
    if len(parts) == 1:
        parts, part = [], np.full(len(part), -1)
    return MeshFile(points, faces, 0, Look(uv, material, part, tuple(library.names), tuple(parts), library.files))


def _add_material(library: MaterialLibrary, material: PBRMaterial | None) -> int:
    """Its number in the library, -1 for none; one of a known name is that."""
    if material is None:
        return -1
    name = library.plain_name(material.name or "material")
    if name in library.names:
        return library.names.index(name)
    colour = [255, 255, 255] if material.baseColorFactor is None else material.baseColorFactor[:3]
    picture = None
    if material.baseColorTexture is not None:
        buffer = io.BytesIO()
        material.baseColorTexture.save(buffer, format="PNG")
        picture = buffer.getvalue()
    return library.add(name, [value / 255 for value in colour], picture, suffix="png")


class MaterialLibrary:
    """Materials as a material library while it grows: `names`, `files` as in `Look`."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.files: dict[str, bytes] = {}

    @staticmethod
    def plain_name(name: str) -> str:
        """A name in letters, digits, underscores, points and dashes, which is that of a file, too."""
        return re.sub(r"[^\w.-]+", "_", name)

    def add(self, name: str, colour: Sequence[float], picture: bytes | None, *, suffix: str) -> int:
        """Its number in `names`. name: plain, and new. colour: linear RGB. picture: a file of that suffix."""
        self.names.append(name)
        text = f"newmtl {name}\nKd " + " ".join(f"{value:.4f}" for value in colour) + "\n"
        if picture is not None:
            self.files[f"{name}.{suffix}"] = picture
            text += f"map_Kd {name}.{suffix}\n"
        self.files[LIBRARY] = self.files.get(LIBRARY, b"") + text.encode()
        return len(self.names) - 1
