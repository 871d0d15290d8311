"""Surfaces as they are in one moment, as a glTF file with their materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physkin_core.export.gltf_builder import glb
from physkin_core.export.gltf_scene import GltfScene
from physkin_core.mesh.look import Look
from physkin_core.model.garment import vertex_normals
from physkin_core.pictures.picture import Mesh

__all__ = ["still_glb"]


def still_glb(meshes: Sequence[Mesh]) -> bytes:
    """A .glb of meshes in the root frame that have a material and places in its pictures, y up as glTF has it."""
    scene = GltfScene()
    for mesh in meshes:
        normals = vertex_normals(mesh.vertices, mesh.faces) if mesh.normals is None else mesh.normals
        cloud = np.concatenate([mesh.vertices, normals], axis=1)
        whole = replace(mesh.surface, faces=np.arange(len(mesh.faces)))
        scene.add_mesh(mesh.surface.name, cloud, mesh.faces, Look.with_places(mesh.places), [whole])
    return glb(scene.finished())
