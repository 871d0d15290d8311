"""A garment as it is in one moment, as a glTF file with its materials, stitches and hems."""

from __future__ import annotations

import numpy as np

from physkin_core.export.gltf_scene import GltfScene
from physkin_core.formats.gltf_builder import glb
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import parts_of

__all__ = ["still_glb"]


def still_glb(look: Look, cloud: np.ndarray, faces: np.ndarray) -> bytes:
    """A .glb, y up as glTF has it. cloud: (n, 6) positions and unit normals in the root frame. faces: (f, 3)."""
    scene = GltfScene()
    for part in parts_of(look, "cloth", (1.0, 1.0, 1.0), faces):
        scene.add_mesh(part, part.on(cloud))
    return glb(scene.builder)
