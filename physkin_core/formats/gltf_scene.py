"""The triangles of a glTF file's scene, as it shows them.

Dimensions: `V` vertices and `f` faces of a primitive.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from physkin_core.file_reading import ContentError
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import GltfFile

__all__ = ["Drawn", "drawn_primitives", "in_scene", "material_of"]


class Drawn(NamedTuple):
    """A primitive at a node.

    positions: (V, 3) in mesh space, with the node's morph weights applied, or else the mesh's. faces: (f, 3) as the
    scene shows them.
    corners: (f, 3) numbers of their corners, counted over the whole file.
    """

    node: int
    mesh: GltfEntry
    primitive: GltfEntry
    positions: np.ndarray
    faces: np.ndarray
    corners: np.ndarray


def drawn_primitives(file: GltfFile) -> Iterator[Drawn]:
    """Everything with faces in the scene. Raises ContentError where it is malformed."""
    corners = 0
    for node in file.scene_nodes():
        number = file.nodes[node].index("mesh")
        if number is None:
            continue
        mesh = file.document.item("meshes", number)
        for primitive in mesh.entries("primitives"):
            if "POSITION" not in primitive.entry("attributes"):
                continue
            faces = file.triangles(primitive)
            if len(faces) == 0:
                continue
            weights = file.nodes[node].numbers("weights") or mesh.numbers("weights") or []
            positions = _positions(file, weights, primitive)
            mirrored = "skin" not in file.nodes[node] and np.linalg.det(file.node_worlds[node][:3, :3]) < 0
            faces = _checked(faces, len(positions))[:, :: -1 if mirrored else 1]
            yield Drawn(node, mesh, primitive, positions, faces, corners + np.arange(faces.size).reshape(-1, 3))
            corners += faces.size


def in_scene(file: GltfFile, node: int, positions: np.ndarray) -> np.ndarray:
    """Positions (V, 3) of a node's mesh where its transform puts them."""
    world = file.node_worlds[node]
    return positions @ world[:3, :3].T + world[:3, 3]


def material_of(file: GltfFile, primitive: GltfEntry) -> GltfEntry | None:
    """The material of a primitive, if it has one."""
    index = primitive.index("material")
    return None if index is None else file.document.item("materials", index)


def _positions(file: GltfFile, weights: Sequence[float], primitive: GltfEntry) -> np.ndarray:
    """(V, 3) with morph targets of these weights applied."""
    positions = file.attribute(primitive, "POSITION").astype(np.float64)
    if positions.shape[1] != 3:
        raise ContentError(f"POSITION of {primitive.where} has {positions.shape[1]} numbers, it must have 3")
    for weight, target in zip(weights, primitive.entries("targets")):
        offset = target.index("POSITION")
        if weight and offset is not None:
            moved = file.accessor(offset)
            if moved.shape != positions.shape:
                raise ContentError(f"{target.where} has shape {moved.shape}, its primitive {positions.shape}")
            positions = positions + weight * moved
    return positions


def _checked(faces: np.ndarray, count: int) -> np.ndarray:
    if faces.min() < 0 or faces.max() >= count:
        raise ContentError(f"face indices span {faces.min()} to {faces.max()}, allowed are 0 to {count - 1}")
    return faces
