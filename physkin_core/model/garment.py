"""Garment mesh and its rest data: what the physics and the quality figures measure against.

Dimensions: `n` vertices, `f` faces, `e` edges, `q` interior edges (hinges), `c` edges along creases, `t` places on the
flat cloth, `k` threads. Metres.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from physkin_core.file_reading import reading
from physkin_core.formats.obj_file import read_obj
from physkin_core.formats.surface_file import read_surface
from physkin_core.model.model_arrays import Array, described
from physkin_core.model.rest_shape import (
    flat_edges,
    graded,
    panel_fault,
    panels_of_texture,
    rest_areas,
    rest_edges,
    side_lengths,
    turned_edges,
)
from physkin_core.model.surface_paths import mesh_edges

__all__ = [
    "LONGEST_THREAD",
    "Garment",
    "GarmentError",
    "face_areas",
    "garment_of_mesh",
    "load_garment",
    "surface_fault",
    "vertex_normals",
]

PLACE_STEP = 2.0**-18
"""[m] What the file holds whole multiples of: places are kept to 2 µm."""
LONGEST_THREAD = 0.1
"""[m] between vertices that are kept together, where the garment is made."""


class GarmentError(ValueError):
    """A garment mesh cannot be used."""


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Triangle areas [m2]. vertices: (..., n, 3). Returns (..., f)."""
    corners = vertices[..., faces, :]
    cross = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    return np.linalg.norm(cross, axis=-1) / 2


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit vertex normals (n, 3); a vertex no face uses gets +Z."""
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shares = np.broadcast_to(face_normals.T[:, :, None], (3, *faces.shape)).reshape(3, -1)
    normals = np.stack([np.bincount(faces.reshape(-1), share, len(vertices)) for share in shares], axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-20, normals / np.maximum(length, 1e-20), np.array([0.0, 0.0, 1.0]))


def surface_fault(vertices: np.ndarray, faces: np.ndarray) -> str | None:
    """Why these are no vertices (n, 3) and faces (f, 3) of a surface, with what is allowed; None if they are."""
    if len(faces) == 0:
        return f"{len(vertices)} vertices and no faces; a triangle mesh is needed"
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        return f"vertices {vertices.shape} and faces {faces.shape} must be (n, 3) and (f, 3)"
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        return f"{len(bad)} vertices are not finite, the first is {bad[0]}: {vertices[bad[0]].tolist()}"
    if faces.dtype.kind not in "iu":
        return f"faces are of type {faces.dtype}, expected an integer index of each corner"
    if faces.min() < 0 or faces.max() >= len(vertices):
        return f"face indices span {faces.min()} to {faces.max()}, allowed 0 to {len(vertices) - 1}"
    return None


@dataclass(frozen=True, eq=False)
class Garment:
    """A triangle mesh in canonical space with its shape at rest: lengths, areas and hinges.

    Attributes:
        vertices: (n, 3) float64 [m], root frame of the body that the garment was made on, in the canonical pose.
        faces: (f, 3) int32.
        creases: (c, 2) edges that keep the angle they are made with, such as a pressed pleat or a stiff seam, while
            other cloth is flat at rest. None: no creases.
        panel_places: (t, 2) float64 [m], where the cloth lies on the flat panels that it was cut from: first across the
            grain (weft), then along it (warp). They are its texture coordinates, too. None: the mesh is its own shape
            at rest.
        panel_faces: (f, 3) int32, index into `panel_places` for each corner of `faces`. A vertex on a seam has one
            place on each panel. Given with `panel_places`, or None.
        threads: (k, 2) vertices that are kept together, such as a button and its hole: first the one that lies over the
            other. At most `LONGEST_THREAD` apart, and not joined by an edge. None: no threads.
        rest_edges: (f, 2, 2) [m], edges of each face at rest, in its plane.
        face_areas: (f,) [m2] at rest.
        vertex_areas: (n,) [m2] at rest, a third of each face for each of its corners.
        edges: (e, 2) int32.
        edge_lengths: (e,) [m] at rest, the mean of both faces' where panels meet.
        face_edges: (f, 3) int32, the edge from each corner to the next.
        hinges: (q, 4) int32, for each edge of two faces its two vertices, then the opposite vertex of either face.
        creased: (q,) bool, hinges along creases.

    Raises:
        GarmentError: for vertices that are not finite, missing or degenerate faces, indices out of range, creases that
            are not edges, panels that do not belong to this mesh, and threads that join nothing or are too long.

    Examples:
        >>> garment = physkin.load_garment_model("tshirt").garment
        >>> garment.vertices.shape[1], bool((garment.edge_lengths > 0).all())  # [m]
        (3, True)
    """

    vertices: np.ndarray = described("vertices", Array("n 3", step=PLACE_STEP))
    faces: np.ndarray = described("faces", Array("f 3", below="n"))
    creases: np.ndarray | None = described("creases", Array("c 2", below="n", optional=True), default=None)
    panel_places: np.ndarray | None = described(
        "panel_places", Array("t 2", step=PLACE_STEP, optional=True), default=None
    )
    panel_faces: np.ndarray | None = described("panel_faces", Array("f 3", below="t", optional=True), default=None)
    threads: np.ndarray | None = described("threads", Array("threads 2", below="n", optional=True), default=None)
    edges: np.ndarray = field(init=False, repr=False)
    face_edges: np.ndarray = field(init=False, repr=False)
    hinges: np.ndarray = field(init=False, repr=False)
    creased: np.ndarray = field(init=False, repr=False)
    rest_edges: np.ndarray = field(init=False, repr=False)
    edge_lengths: np.ndarray = field(init=False, repr=False)
    face_areas: np.ndarray = field(init=False, repr=False)
    vertex_areas: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        faces = np.asarray(self.faces)
        if fault := surface_fault(vertices, faces):
            raise GarmentError(f"garment mesh: {fault}")
        self._set(faces=np.array(faces, dtype=np.int32, order="C"))
        edges, areas = self._lying(vertices)
        self._set(vertices=vertices, **_connections(self.faces))
        if self.panel_places is not None or self.panel_faces is not None:
            panels = self._checked_panels(areas)
            self._set(**panels)
            edges = turned_edges(flat_edges(panels["panel_places"][panels["panel_faces"]]), edges)
            areas = rest_areas(edges)
        self._set(**self._at_rest(edges, areas))
        self._set(**self._checked_creases(), **self._checked_threads())

    def reshaped(self, vertices: np.ndarray) -> Garment:
        """The same mesh with another shape at rest.

        Args:
            vertices: (n, 3) [m] of the mesh at rest. If it has panels, each panel face is stretched as its face of
                the mesh is.

        Returns:
            A new garment.

        Raises:
            GarmentError: as the class does.
        """
        vertices = np.array(vertices, dtype=np.float64, order="C")
        if vertices.shape != self.vertices.shape or not np.isfinite(vertices).all():
            raise GarmentError(f"a rest shape must be finite {self.vertices.shape}, got shape {vertices.shape}")
        other, (edges, areas) = copy.copy(self), self._lying(vertices)
        if self.panel_places is not None:
            edges = graded(self.rest_edges, self._lying(self.vertices)[0], edges)
            areas = rest_areas(edges)
        other._set(vertices=vertices, **other._at_rest(edges, areas))
        return other

    def submesh(self, chosen: np.ndarray) -> Garment:
        """Some faces with their vertices, in the same order and with the same shape at rest, and the threads between
        these.

        Args:
            chosen: (f,) bool.

        Returns:
            A new garment.
        """
        used, faces = np.unique(self.faces[chosen], return_inverse=True)
        other = Garment(self.vertices[used], faces.reshape(-1, 3))
        other._set(**other._at_rest(self.rest_edges[chosen], self.face_areas[chosen]))
        if self.threads is not None and len(kept := self.threads[np.isin(self.threads, used).all(axis=1)]):
            other._set(threads=np.searchsorted(used, kept).astype(np.int32))
        return other

    def _lying(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rest edges and areas of the mesh as vertices lie. Raises GarmentError where a face has no area."""
        areas = face_areas(vertices, self.faces)
        if areas.min() < 1e-12:
            raise GarmentError(f"garment face {int(areas.argmin())} is degenerate: area {areas.min():.2e} m2")
        return rest_edges(vertices[self.faces], areas), areas

    def _at_rest(self, edges: np.ndarray, areas: np.ndarray) -> dict[str, np.ndarray]:
        """What depends on the rest shape, of rest edges and areas of the faces."""
        sides, corners = self.face_edges.reshape(-1), self.faces.reshape(-1)
        return {
            "rest_edges": edges,
            "edge_lengths": np.bincount(sides, side_lengths(edges).reshape(-1)) / np.bincount(sides),
            "face_areas": areas,
            "vertex_areas": np.bincount(corners, weights=np.repeat(areas / 3, 3), minlength=len(self.vertices)),
        }

    def _checked_panels(self, areas: np.ndarray) -> dict[str, np.ndarray]:
        """Of a mesh whose faces have areas (f,)."""
        if self.panel_places is None or self.panel_faces is None:
            raise GarmentError("a garment has both panel places and panel faces, or neither")
        places, panel_faces = np.array(self.panel_places, dtype=np.float64, order="C"), np.asarray(self.panel_faces)
        with np.errstate(over="ignore", invalid="ignore"):
            fault = panel_fault(places, panel_faces, areas)
        if fault:
            raise GarmentError(f"garment panels: {fault}")
        return {"panel_places": places, "panel_faces": np.array(panel_faces, dtype=np.int32, order="C")}

    def _checked_creases(self) -> dict[str, np.ndarray]:
        if self.creases is None:
            return {"creased": np.zeros(len(self.hinges), bool)}
        creases, count = np.asarray(self.creases), len(self.vertices)
        if creases.ndim != 2 or creases.shape[1] != 2 or creases.dtype.kind not in "iu" or not len(creases):
            raise GarmentError(f"creases {creases.shape} of {creases.dtype} must be (c, 2) vertex indices, one or more")
        along, edges, hinges = (_keys(pairs, count) for pairs in (creases, self.edges, self.hinges[:, :2]))
        there = np.isin(along, edges) & (creases >= 0).all(axis=1) & (creases < count).all(axis=1)
        if not there.all():
            raise GarmentError(
                f"{np.sum(~there)} creases run along no edge of the mesh, the first is from vertex "
                f"{' to '.join(map(str, creases[~there][0]))}; mark creases along edges alone"
            )
        return {"creases": creases.astype(np.int32), "creased": np.isin(hinges, along)}

    def _checked_threads(self) -> dict[str, np.ndarray]:
        if self.threads is None:
            return {}
        threads, count = np.asarray(self.threads), len(self.vertices)
        if threads.ndim != 2 or threads.shape[1] != 2 or threads.dtype.kind not in "iu" or not len(threads):
            raise GarmentError(f"threads {threads.shape} of {threads.dtype} must be (k, 2) vertex indices, one or more")
        if threads.min() < 0 or threads.max() >= count:
            raise GarmentError(f"threads hold {threads.min()} to {threads.max()}, allowed 0 to {count - 1}")
        keys = _keys(threads, count)
        again = np.ones(len(keys), bool)
        again[np.unique(keys, return_index=True)[1]] = False
        length = np.linalg.norm(np.diff(self.vertices[threads], axis=1)[:, 0], axis=1)
        for fault, why in (
            (threads[:, 0] == threads[:, 1], "join a vertex to itself"),
            (~np.isin(threads, self.faces).all(axis=1), "end at a vertex that no face has"),
            (np.isin(keys, _keys(self.edges, count)), "run along an edge of the mesh"),
            (again, "are there already"),
            (length > LONGEST_THREAD + PLACE_STEP, f"are longer than {LONGEST_THREAD} m, up to {length.max():.3f} m"),
        ):
            if fault.any():
                raise GarmentError(
                    f"{fault.sum()} threads {why}, the first is from vertex "
                    f"{' to '.join(map(str, threads[fault][0]))}; give each pair of points to keep together once"
                )
        return {"threads": threads.astype(np.int32)}

    def _set(self, **arrays: np.ndarray) -> None:
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)


def load_garment(path: str | Path) -> Garment:
    """Read a garment mesh.

    Vertices at equal positions (texture seams, the triangle soup of an STL file) become one. Line elements of an OBJ
    are the garment's creases where they run along edges of faces, and its threads elsewhere. Its texture coordinates
    are taken for its flat panels if their sizes show that they are in metres.

    Args:
        path: OBJ, PLY or STL file; metres, in the root frame of its canonical body.

    Returns:
        The garment.

    Raises:
        GarmentError: naming what is wrong with the file or mesh.

    Examples:
        >>> garment = physkin.load_garment("my.obj")
        >>> garment.vertices.shape[1], garment.panel_places is None
        (3, False)
    """
    path = Path(path)
    with reading(f"garment {path}", GarmentError):
        if path.suffix.lower() == ".obj":
            file = read_obj(path)
            return garment_of_mesh(file.vertices, file.faces, line_elements=file.line_elements, uv=file.uv)
        return garment_of_mesh(*read_surface(path))


def garment_of_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    line_elements: np.ndarray | None = None,
    uv: np.ndarray | None = None,
) -> Garment:
    """What a mesh file holds, as a garment: see `load_garment`.

    Args:
        vertices: (n, 3) [m].
        faces: (f, 3).
        line_elements: (k, 2) creases, which are edges of the mesh, and threads; None: none.
        uv: (f, 3, 2) texture coordinates of the corners of faces, not finite where there are none; None: none.

    Returns:
        The garment.

    Raises:
        GarmentError: naming what is wrong with the mesh.
    """
    garment = Garment(vertices, faces)
    vertices, faces = garment.vertices, garment.faces
    lines = np.zeros((0, 2), int) if line_elements is None else line_elements
    _, first, inverse = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    if len(first) < len(vertices):
        kept, place = np.unique(first, return_inverse=True)
        place = place[inverse.reshape(-1)]
        vertices, faces, lines = vertices[kept], place[faces], place[lines]
    panels = None if uv is None else panels_of_texture(vertices, faces, garment.face_areas, uv)[0]
    if vertices is garment.vertices and not len(lines) and panels is None:
        return garment
    along = np.isin(_keys(lines, len(vertices)), _keys(mesh_edges(faces)[0], len(vertices)))
    creases, threads = (each if len(each) else None for each in (lines[along], lines[~along]))
    places, panel_faces = panels or (None, None)
    return Garment(vertices, faces, creases, places, panel_faces, threads)


def _keys(pairs: np.ndarray, count: int) -> np.ndarray:
    """(p,) a number of each pair (p, 2) of `count` vertices, whatever their order."""
    return np.sort(pairs, axis=1).astype(np.int64) @ [count, 1]


def _connections(faces: np.ndarray) -> dict[str, np.ndarray]:
    """Edges, those of faces, and hinges."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    ordered = np.sort(directed, axis=1).astype(np.int64)
    size = int(ordered.max()) + 1
    keys, owner, count = np.unique(ordered[:, 0] * size + ordered[:, 1], return_inverse=True, return_counts=True)
    edges = np.stack(np.divmod(keys, size), axis=1)
    if count.max() > 2:
        first = edges[int(count.argmax())]
        raise GarmentError(f"edge {first.tolist()} is shared by {count.max()} faces; a garment must be manifold")
    owner = owner.reshape(-1)
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.flatnonzero(count == 2))
    first, second = order[start], order[start + 1]
    hinges = np.column_stack([directed[first], opposite[first], opposite[second]])
    found = {"edges": edges, "face_edges": owner.reshape(3, -1).T, "hinges": hinges}
    return {name: np.array(array, dtype=np.int32, order="C") for name, array in found.items()}
