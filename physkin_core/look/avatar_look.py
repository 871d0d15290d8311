"""The look of an avatar by its own file: glTF, VRM and OBJ. It is read when somebody looks, not with the body.

Dimensions: `F` triangles of the file, `f` faces of the avatar.
"""

from __future__ import annotations

import io
import logging
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.avatar.gltf_avatar import primitives
from physkin_core.avatar.gltf_file import GltfFile
from physkin_core.avatar.loading import GLTF_SUFFIXES
from physkin_core.look.surfaces import few_colours, picture_kind, readable
from physkin_core.mesh_file import Look, MaterialLibrary, read_mesh

__all__ = ["avatar_look"]

log = logging.getLogger(__name__)

MOST_PAINTED = 32
"""Colours of one part whose vertices are painted."""
TRANSFORM, WEBP = "KHR_texture_transform", "EXT_texture_webp"


def avatar_look(avatar: Avatar, faces: np.ndarray | slice = slice(None)) -> Look | None:
    """Materials and texture places of an avatar's faces, or of some; None where its file has no materials.

    Base colours and their pictures are kept, and where there are none colours of vertices, as few materials; other maps
    are not. faces: (f,) a mask or indices. A look hinders nobody from draping: what cannot be read, a picture or all of
    it, is told in the log.
    """
    path = Path(avatar.source)
    if avatar.file_corners is None or path.suffix.lower() not in (".obj", *GLTF_SUFFIXES):
        return None
    try:
        look = _obj_look(path) if path.suffix.lower() == ".obj" else _gltf_look(GltfFile(path))
        return look.of_corners(avatar.file_corners[faces]) if look.materials else None
    except (AttributeError, IndexError, KeyError, OSError, TypeError, ValueError) as error:
        log.warning("avatar %s: its materials cannot be read: %s", path, error)
        return None


def _obj_look(path: Path) -> Look:
    return readable(
        read_mesh(path).look, lambda told: log.warning("avatar %s: left out of its materials: %s", path, told)
    )


def _gltf_look(file: GltfFile) -> Look:
    """Of all triangles of the scene (F,), in the order of `primitives`."""
    library, places, material = MaterialLibrary(), [], []
    number: dict[int, int] = {}
    for _, primitive, _, faces, _ in primitives(file):
        index = primitive.material
        painted = _painted(file, primitive, faces)
        places.append(_places(file, primitive)[faces])
        if painted is not None:
            material.append(_add_painted(library, painted))
            continue
        if index is not None and index not in number:
            number[index] = _add_material(library, file, index)
        material.append(np.full(len(faces), -1 if index is None else number[index]))
    count = sum(map(len, material))
    return Look(
        np.concatenate(places), np.concatenate(material), np.full(count, -1), tuple(library.names), (), library.files
    )


def _places(file: GltfFile, primitive) -> np.ndarray:
    """(V, 2) where the vertices of a primitive are in its base colour's picture, origin at the lower left; NaN where
    the file does not say."""
    used = None if primitive.material is None else _base_picture(file, primitive.material)
    transform = {} if used is None else (used.extensions or {}).get(TRANSFORM, {})
    channel = 0 if used is None else transform.get("texCoord", used.texCoord or 0)
    found = file.attribute(primitive, f"TEXCOORD_{channel}")
    if found is None:
        return np.full((len(file.attribute(primitive, "POSITION")), 2), np.nan)
    found = found * transform.get("scale", (1, 1)) + transform.get("offset", (0, 0))
    return found * [1, -1] + [0, 1]


def _painted(file: GltfFile, primitive, faces: np.ndarray) -> np.ndarray | None:
    """(f, 3) linear RGB that vertices give the faces of a primitive; None where all is white or there is a picture."""
    colours = file.attribute(primitive, "COLOR_0")
    if colours is None or (primitive.material is not None and _base_picture(file, primitive.material) is not None):
        return None
    colours = np.clip(colours[:, :3], 0, 1)
    return None if (colours == 1).all() else colours[faces].mean(axis=1) * _base_colour(file, primitive.material)


def _add_painted(library: MaterialLibrary, colours: np.ndarray) -> np.ndarray:
    """Materials that stand for linear colours (f, 3), and which of them (f,) each face has."""
    palette, index = few_colours(colours ** (1 / 2.2), MOST_PAINTED)
    first = len(library.names)
    for number, colour in enumerate(palette, start=first):
        library.add(f"painted_{number}", colour**2.2, None, suffix="png")
    return first + index


def _base_colour(file: GltfFile, material: int | None) -> np.ndarray:
    """(3,) linear RGB of a material, white where nothing is said."""
    shading = None if material is None else file.document.materials[material].pbrMetallicRoughness
    return np.clip(((shading.baseColorFactor if shading is not None else None) or (1, 1, 1))[:3], 0, 1)


def _base_picture(file: GltfFile, material: int):
    """pygltflib's `TextureInfo` of a material's base colour, if there is one."""
    shading = file.document.materials[material].pbrMetallicRoughness
    return None if shading is None else shading.baseColorTexture


def _add_material(library: MaterialLibrary, file: GltfFile, index: int) -> int:
    """Its number in the library; materials of one name are told apart."""
    material = file.document.materials[index]
    name = library.plain_name(material.name or f"material_{index}")
    name = f"{name}_{index}" if name in library.names else name
    content, used = None, _base_picture(file, index)
    if used is not None:
        try:
            content = _readable(_picture(file, file.document.textures[used.index]))
        except AvatarError as error:
            log.warning("avatar %s: material %r is shown without its picture: %s", file.path, name, error)
    suffix = "jpg" if content is not None and picture_kind(content) == "image/jpeg" else "png"
    return library.add(name, _base_colour(file, index), content, suffix=suffix)


def _picture(file: GltfFile, texture) -> bytes:
    source = (texture.extensions or {}).get(WEBP, {}).get("source", texture.source)
    return b"" if source is None else file.picture(source)


def _readable(content: bytes) -> bytes:
    """A picture as PNG or JPEG. Raises AvatarError where it cannot be made one."""
    if picture_kind(content) is not None:
        return content
    try:
        from PIL import Image

        buffer = io.BytesIO()
        Image.open(io.BytesIO(content)).save(buffer, format="PNG")
    except Exception as error:  # whatever pillow trips over, or there is none
        raise AvatarError("it is neither PNG nor JPEG, nor WebP that pillow reads") from error
    return buffer.getvalue()
