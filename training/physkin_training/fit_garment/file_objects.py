"""Objects of a garment file: those that it names, or else its connected pieces by number, the largest first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from physkin_core.file_reading import listed
from physkin_core.mesh.mesh_file import MeshFile
from physkin_training.fit_garment.mesh_repair import face_components

__all__ = ["chosen_objects", "objects_at"]


def chosen_objects(mesh: MeshFile, chosen: Sequence[str]) -> MeshFile:
    """A file with its objects of these names alone. Raises ValueError for a name that it has not."""
    names, number = _objects(mesh)
    if missing := [name for name in chosen if name not in names]:
        raise ValueError(f"no object {missing[0]!r} in the garment's file; it has {listed(names)}")
    kept = np.isin(number, [names.index(name) for name in chosen])
    look = mesh.look
    look = replace(look, uv=look.uv[kept], material=look.material[kept], part=look.part[kept])
    return replace(mesh, faces=mesh.faces[kept], look=look)


def objects_at(mesh: MeshFile, centres: np.ndarray) -> Callable[[np.ndarray], str]:
    """Names the objects of a file, whose faces are at `centres` (f, 3), that points (p, 3) belong to."""
    names, number = _objects(mesh)
    tree = cKDTree(centres)
    return lambda points: listed([names[index] for index in np.unique(number[tree.query(points)[1]]) if index >= 0])


def _objects(mesh: MeshFile) -> tuple[tuple[str, ...], np.ndarray]:
    """Names, and the number of each face (f,) among them; -1 for one that belongs to none."""
    if mesh.look.parts:
        return mesh.look.parts, mesh.look.part
    place = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    label = face_components(place[mesh.faces])
    rank = np.argsort(np.argsort(-np.bincount(label), kind="stable"))
    return tuple(str(index + 1) for index in range(len(rank))), rank[label]
