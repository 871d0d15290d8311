"""Surfaces as they are in one moment, as a glTF file with their materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physkin_core.export.gltf_builder import glb
from physkin_core.export.gltf_scene import GltfScene
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import Part
from physkin_core.pictures.picture import Mesh

__all__ = ["still_glb"]


def still_glb(meshes: Sequence[Mesh]) -> bytes:
    """A .glb of meshes in the root frame that have a material and places in its pictures, y up as glTF has it."""
    scene = GltfScene()
    for mesh in meshes:
        cloud = np.concatenate([mesh.vertices, mesh.vertex_normals], axis=1)
        whole = replace(mesh.surface, faces=np.arange(len(mesh.faces)))
        scene.add_mesh(Part(whole.name, mesh.faces, Look.with_places(mesh.places), [whole]), cloud)
    return glb(scene.builder)
