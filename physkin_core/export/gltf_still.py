"""Surfaces as they are in one moment, as a glTF file with their materials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.export.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, glb
from physkin_core.export.gltf_materials import GltfMaterials
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import split_at_seams
from physkin_core.model.garment import vertex_normals
from physkin_core.picture import Mesh

__all__ = ["still_glb"]


def still_glb(meshes: Sequence[Mesh]) -> bytes:
    """A .glb of meshes in the root frame that have a material and places in its pictures, y up as glTF has it."""
    builder = GltfBuilder({"generator": "PhySkin"})
    materials = GltfMaterials(builder)
    found: list[dict] = []
    for mesh in meshes:
        own, places, faces = split_at_seams(Look.with_places(mesh.places), mesh.faces)
        normals = vertex_normals(mesh.vertices, mesh.faces) if mesh.normals is None else mesh.normals
        attributes = {
            "POSITION": builder.add_accessor((mesh.vertices[own] @ FROM_ROOT_FRAME.T).astype(np.float32)),
            "NORMAL": builder.add_accessor((normals[own] @ FROM_ROOT_FRAME.T).astype(np.float32)),
            "TEXCOORD_0": builder.add_accessor((places * [1, -1] + [0, 1]).astype(np.float32)),
        }
        indices = builder.add_accessor(faces.astype(np.uint32).reshape(-1))
        primitive = {"attributes": attributes, "indices": indices, "material": materials.add(mesh.surface)}
        found.append({"primitives": [primitive]})
    nodes = [{"mesh": mesh} for mesh in range(len(found))]
    builder.document |= {"scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": found}
    materials.finish()
    return glb(builder)
