"""The look of an avatar by its own file, glTF, VRM or OBJ, and one colour a face of it, for what draws no textures. It
is read when somebody looks, not with the body.

Dimensions: `f` faces of the avatar.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import lru_cache
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
from physkin_core.mesh.picture_samples import sampled_picture
from physkin_core.mesh.surfaces import Surface, readable, surfaces_of
from physkin_core.model.garment import GarmentError
from physkin_core.pictures.picture import BODY_COLOUR, pillow

__all__ = ["avatar_colours", "avatar_look"]

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


@lru_cache(maxsize=4)  # a film asks for the same avatar in every frame
def avatar_colours(avatar: Avatar) -> np.ndarray | None:
    """(f, 3) sRGB in [0, 1] of an avatar's faces by its own file; None where that has no materials. A damaged picture
    is left out and logged.

    Raises PictureError where pictures need pillow.
    """
    look = avatar_look(avatar)
    if look is None:
        return None
    found = np.empty((len(look.material), 3))
    for surface in surfaces_of(look, "plain", BODY_COLOUR, len(found)):
        found[surface.faces] = surface.colour * _picture_colours(surface, look.uv[surface.faces])
    return found ** (1 / 2.2)


def _picture_colours(surface: Surface, uv: np.ndarray) -> np.ndarray:
    """(k, 3) linear RGB of faces with texture coordinates (k, 3, 2); ones without a picture."""
    if surface.picture is None:
        return np.ones((len(uv), 3))
    pillow()
    try:
        samples = sampled_picture(surface.picture.content, uv * surface.repeats, "RGB")
    except Exception as error:  # whatever pillow trips over: damaged files, some too large
        log.warning("picture %s is left out: %s", surface.picture.name, error)
        return np.ones((len(uv), 3))
    return (samples**2.2).mean(axis=0)


def _obj_look(path: Path, warn: Callable[[str], None]) -> Look:
    return readable(read_mesh(path).look, lambda text: warn(f"left out of its materials: {text}"))


def _gltf_look(path: Path, warn: Callable[[str], None]) -> Look:
    with reading(f"avatar {path}", AvatarError):
        file = GltfFile(path, clips=False)
        return gltf_look(file, drawn_primitives(file), warn)
