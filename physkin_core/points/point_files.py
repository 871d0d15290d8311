"""Files of a garment's other representations: read, moved, and written with all else that is in them.

Dimensions: `n` points. Arrays are float64, in the file's own frame and unit.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.file_reading import ContentError, read_bytes, reading
from physkin_core.formats.gltf_document import parse_gltf
from physkin_core.formats.obj_file import read_obj
from physkin_core.formats.ply_file import read_ply
from physkin_core.points.splats import Splats

__all__ = ["POINT_FILES", "PointFile", "PointFileError", "read_points", "read_splat_file", "splat_colours"]

POSITION, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
ROTATION, SCALE = ("rot_1", "rot_2", "rot_3", "rot_0"), ("scale_0", "scale_1", "scale_2")
"""Of a splat: a quaternion x, y, z, w, and logarithms of standard deviations."""
PLAIN_COLOUR, CONSTANT_HARMONIC = ("f_dc_0", "f_dc_1", "f_dc_2"), 0.5 / np.sqrt(np.pi)
"""A splat's spherical harmonics of order 0, and what they are factors of."""


class PointFileError(ValueError):
    """A file of points cannot be read, or does not hold what it is used as."""


@dataclass(frozen=True)
class PointFile:
    """points: (n, 3). normals: (n, 3) unit, where the file has any that must move with the points. splats: what the
    points are, if they are splats. up: axis of the file that is up, if its format says so.

    write: writes the file to a path with other points, and other normals or None; write_splats: with other splats.
    look: (n,) records of all else that a splat has, such as opacity and colour, where there is any.
    """

    points: np.ndarray
    write: Callable[[Path, np.ndarray, np.ndarray | None], None]
    normals: np.ndarray | None = None
    splats: Splats | None = None
    write_splats: Callable[[Path, Splats], None] | None = None
    look: np.ndarray | None = None
    up: str = "Z"


def read_points(path: str | Path) -> PointFile:
    """Read a mesh, point cloud or splats.

    PLY: anything; vertices with `rot_0` to `rot_3` and `scale_0` to `scale_2` are splats. OBJ, GLB: meshes.
    Raises PointFileError naming what is wrong with the file and what is allowed.
    """
    path = Path(path)
    with reading(f"points file {path}", PointFileError):
        read = POINT_FILES.get(path.suffix.lower())
        if read is None:
            raise ContentError(f"allowed are {', '.join(POINT_FILES)}")
        file = read(path)
        if len(file.points) == 0 or not np.isfinite(file.points).all():
            raise ContentError(f"its {len(file.points)} points must be at least one, and finite")
    return file


def read_splat_file(path: str | Path) -> PointFile:
    """Read splats. Raises as `read_points`, for a file without them, too."""
    file = read_points(path)
    if file.splats is None:
        raise PointFileError(f"cannot use {path} as points: they are no Gaussian splats with rot_0 to rot_3 and scales")
    return file


def splat_colours(look: np.ndarray | None, count: int) -> tuple[np.ndarray | None, np.ndarray]:
    """sRGB (n, 3) in [0, 1] of splats seen from everywhere alike, None where their `PointFile.look` does not say, and
    opacity (n,), 1 where it does not."""
    names = () if look is None else look.dtype.names
    colours, opacity = None, np.ones(count)
    if set(PLAIN_COLOUR) <= set(names):
        plain = np.stack([look[name] for name in PLAIN_COLOUR], axis=1)
        colours = np.clip(0.5 + CONSTANT_HARMONIC * plain.astype(np.float64), 0, 1)
    if "opacity" in names:
        with np.errstate(over="ignore"):
            opacity = 1 / (1 + np.exp(-look["opacity"].astype(np.float64)))
    return colours, opacity


def _read_ply(path: Path) -> PointFile:
    ply = read_ply(path)
    points, normals = ply.columns(POSITION), ply.columns(NORMAL)
    rotations, scales = ply.columns(ROTATION), ply.columns(SCALE)

    def write(to: Path, moved: np.ndarray, turned: np.ndarray | None) -> None:
        columns = moved if turned is None else np.column_stack([moved, turned])
        ply.write(to, dict(zip((*POSITION, *NORMAL), columns.T)))

    def write_splats(to: Path, moved: Splats) -> None:
        columns = np.column_stack([moved.centres, moved.rotations, np.log(moved.scales)])
        ply.write(to, dict(zip((*POSITION, *ROTATION, *SCALE), columns.T)))

    if rotations is not None and scales is not None:
        with np.errstate(over="ignore"):
            splats = Splats(points, rotations, np.exp(scales))
        rest = [name for name in ply.vertices.dtype.names if name not in (*POSITION, *ROTATION, *SCALE)]
        look = ply.vertices[rest] if rest else None
        return PointFile(points, write, splats=splats, write_splats=write_splats, look=look)
    if normals is not None and (np.linalg.norm(normals, axis=1) < 1e-9).any():
        normals = None  # a column of zeros is how many tools leave them out
    return PointFile(points, write, normals=normals)


def _read_obj(path: Path) -> PointFile:
    file = read_obj(path)
    return PointFile(file.vertices, lambda to, moved, normals: file.write(to, moved))


def _read_glb(path: Path) -> PointFile:
    """All meshes of the scene, in its frame, by trimesh, which can write it again, looks and all. Skins and animations
    are left out."""
    import trimesh

    content = read_bytes(path)
    parse_gltf(content)  # it says more clearly what is wrong
    scene = trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False)
    placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
    found = [(scene.geometry[name], transform) for transform, name in placed]
    meshes = [  # the cache has the file's own normals
        mesh.copy(include_cache=True).apply_transform(transform)
        for mesh, transform in found
        if isinstance(mesh, trimesh.Trimesh)
    ]
    if not meshes:
        raise ContentError("it holds no mesh")
    ends = np.cumsum([len(mesh.vertices) for mesh in meshes])[:-1]
    normals = np.concatenate([mesh.vertex_normals for mesh in meshes])
    normals[np.linalg.norm(normals, axis=1) < 1e-9] = [0, 1, 0]  # of vertices without a face

    def write(to: Path, moved: np.ndarray, moved_normals: np.ndarray | None) -> None:
        written = trimesh.Scene()
        for mesh, points, turned in zip(meshes, np.split(moved, ends), np.split(moved_normals, ends)):
            look = {"visual": mesh.visual, "process": False}
            written.add_geometry(trimesh.Trimesh(points, mesh.faces, vertex_normals=turned, **look))
        to.write_bytes(written.export(file_type="glb", include_normals=True))

    return PointFile(np.concatenate([mesh.vertices for mesh in meshes]), write, normals=normals, up="Y")


POINT_FILES = {".ply": _read_ply, ".obj": _read_obj, ".glb": _read_glb}
"""What reads each kind of file."""
