"""The surface of an avatar as its file has it: in its own pose, axes and unit.

Dimensions: `V` vertices of the loaded avatar.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.avatar.gltf_avatar import _frame, _plain_mesh, _skinned_mesh
from physkin_core.avatar.gltf_file import GltfFile
from physkin_core.avatar.loading import GLTF_SUFFIXES
from physkin_core.avatar.mesh_avatar import _read_surface
from physkin_core.avatar.retargeting import clean_surface

__all__ = ["file_surface"]


def file_surface(path: str | Path, avatar: Avatar) -> np.ndarray:
    """Where the file that `avatar` was loaded from shows its vertices, (V, 3) float64 in the file's frame and unit.

    Raises AvatarError where they are not as many as the avatar's.
    """
    path = Path(path)
    file = GltfFile(path) if path.suffix.lower() in GLTF_SUFFIXES else None
    if file is not None and file.document.skins:
        vertices = _skinned_mesh(file).vertices @ _frame(file)
    else:
        surface = _read_surface(path) if file is None else _plain_mesh(file)
        vertices, _, _ = clean_surface(*surface, (), str(path))
    if len(vertices) != len(avatar.vertices):
        raise AvatarError(
            f"avatar {path} has {len(vertices)} different vertices, {len(avatar.vertices)} with their skinning "
            "weights; vertices at one place must have the same weights"
        )
    return vertices
