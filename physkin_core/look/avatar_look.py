"""The look of an avatar by its own file: glTF, VRM and OBJ. It is read when somebody looks, not with the body.

Dimensions: `f` faces of the avatar.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.avatar.loading import GLTF_SUFFIXES
from physkin_core.file_reading import reading, sentence
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_scene import drawn_primitives
from physkin_core.mesh.gltf_look import gltf_look
from physkin_core.mesh.look import Look
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.mesh.surfaces import readable
from physkin_core.model.garment import GarmentError

__all__ = ["avatar_look"]

log = logging.getLogger(__name__)


def avatar_look(avatar: Avatar, faces: np.ndarray | slice = slice(None)) -> Look | None:
    """Materials and texture coordinates of an avatar's faces, or of some; None where its file has no materials.

    Base colours and their pictures are kept, and where there are none colours of vertices, as few materials; other maps
    are not. faces: (f,) a mask or indices. A look hinders nobody from draping: what cannot be read, a picture or all of
    it, is logged.
    """
    path = Path(avatar.source)
    if avatar.file_corners is None or path.suffix.lower() not in (".obj", *GLTF_SUFFIXES):
        return None

    def warn(text: str) -> None:
        log.warning("%s", sentence(f"avatar {path}: {text}"))

    try:
        look = _obj_look(path, warn) if path.suffix.lower() == ".obj" else _gltf_look(path, warn)
        if not look.materials:
            return None
        with reading(f"avatar {path}", AvatarError):  # it may have changed since
            return look.of_corners(avatar.file_corners[faces])
    except (AvatarError, GarmentError) as error:
        log.warning("an avatar's materials cannot be read: %s", error)
        return None


def _obj_look(path: Path, warn: Callable[[str], None]) -> Look:
    return readable(read_mesh(path).look, lambda text: warn(f"left out of its materials: {text}"))


def _gltf_look(path: Path, warn: Callable[[str], None]) -> Look:
    with reading(f"avatar {path}", AvatarError):
        file = GltfFile(path)
        return gltf_look(file, drawn_primitives(file), warn)
