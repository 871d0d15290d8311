"""The look of a glTF file: base colours and their pictures, or colours of vertices, as a material library; and which
faces are seen: a material may let what is behind it show through, all over or where its picture is clear, as between
the lashes on a card.

Dimensions: `F` triangles of a scene, `V` vertices and `f` faces of a primitive.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable

import numpy as np

from physkin_core.file_reading import ContentError
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_scene import Drawn, material_of
from physkin_core.mesh.look import Look, MaterialLibrary, few_colours, picture_kind
from physkin_core.mesh.picture_samples import sampled_picture

__all__ = ["gltf_look", "seen_faces", "shows_through"]

MOST_PAINTED = 32
"""Colours of one part whose vertices are painted."""
CLEAR = 1 / 3
"""Opacity below which a face is left out of pictures, which draw no clear ones."""
TRANSFORM, WEBP = "KHR_texture_transform", "EXT_texture_webp"


def gltf_look(file: GltfFile, drawn: Iterable[Drawn], warn: Callable[[str], None]) -> Look:
    """Of all triangles of the scene (F,), in the order of `drawn_primitives`. Other maps than base colours are left
    out. warn: called with the reason for each picture that cannot be read. Raises ContentError."""
    library, places, materials = MaterialLibrary(), [], []
    number: dict[int, int] = {}
    for each in drawn:
        material, index = material_of(file, each.primitive), each.primitive.index("material")
        painted = _painted(file, each, material)
        places.append(_texture_places(file, each, material)[each.faces])
        if painted is not None:
            materials.append(_add_painted(library, painted))
            continue
        if material is not None and index not in number:
            number[index] = _add_material(library, file, material, index, warn)
        materials.append(np.full(len(each.faces), -1 if material is None else number[index]))
    count = sum(map(len, materials))
    return Look(
        np.concatenate(places), np.concatenate(materials), np.full(count, -1), tuple(library.names), (), library.files
    )


def shows_through(file: GltfFile, drawn: Drawn) -> bool:
    """Whether what is behind a primitive may show through, as through lenses and the cards of lashes."""
    material = material_of(file, drawn.primitive)
    return material is not None and material.text("alphaMode") in ("BLEND", "MASK")


def seen_faces(file: GltfFile, drawn: Drawn) -> np.ndarray:
    """(f,) bool: faces that are not clear. What cannot be read is taken to be opaque: `avatar_look` says so."""
    if shows_through(file, drawn):
        try:
            return _opacity(file, drawn) >= CLEAR
        except Exception:  # whatever pillow trips over, or there is none; a look hinders nobody from draping
            pass
    return np.ones(len(drawn.faces), dtype=bool)


def _opacity(file: GltfFile, drawn: Drawn) -> np.ndarray:
    """(f,) mean opacity of the base colour, with its picture."""
    material = material_of(file, drawn.primitive)
    factor = material.entry("pbrMetallicRoughness").numbers("baseColorFactor", 4)
    opacity = np.full(len(drawn.faces), 1.0 if factor is None else factor[3])
    used = _base_picture(material)
    if used is not None:
        content = _picture_content(file, file.document.item("textures", used.integer("index")))
        uv = _texture_places(file, drawn, material)[drawn.faces]
        opacity *= sampled_picture(content, uv, "A").mean(axis=0)
    return opacity


def _texture_places(file: GltfFile, drawn: Drawn, material: GltfEntry | None) -> np.ndarray:
    """(V, 2) where the vertices of a primitive are in its base colour's picture, origin at the lower left; NaN where
    the file does not say."""
    used = None if material is None else _base_picture(material)
    transform = GltfEntry({}, TRANSFORM) if used is None else used.entry("extensions").entry(TRANSFORM)
    channel = 0 if used is None else transform.integer("texCoord", used.integer("texCoord", 0))
    found = file.attribute(drawn.primitive, f"TEXCOORD_{channel}")
    if found is None:
        return np.full((len(drawn.positions), 2), np.nan)
    _check_rows("texture coordinates", found, drawn, (2,))
    found = found * (transform.numbers("scale", 2) or (1, 1)) + (transform.numbers("offset", 2) or (0, 0))
    return found * [1, -1] + [0, 1]


def _painted(file: GltfFile, drawn: Drawn, material: GltfEntry | None) -> np.ndarray | None:
    """(f, 3) linear RGB that vertices give the faces of a primitive; None where all is white or there is a picture."""
    colours = file.attribute(drawn.primitive, "COLOR_0")
    if colours is None or (material is not None and _base_picture(material) is not None):
        return None
    _check_rows("colours", colours, drawn, (3, 4))
    colours = np.clip(colours[:, :3], 0, 1)
    return None if (colours == 1).all() else colours[drawn.faces].mean(axis=1) * _base_colour(material)


def _check_rows(what: str, found: np.ndarray, drawn: Drawn, widths: tuple[int, ...]) -> None:
    if len(found) != len(drawn.positions) or found.shape[1] not in widths:
        raise ContentError(f"{what} of {drawn.primitive.where} have shape {found.shape}, one is needed for each vertex")


def _add_painted(library: MaterialLibrary, colours: np.ndarray) -> np.ndarray:
    """Materials that stand for linear colours (f, 3), and which of them (f,) each face has."""
    palette, index = few_colours(colours ** (1 / 2.2), MOST_PAINTED)
    first = len(library.names)
    for number, colour in enumerate(palette, start=first):
        library.add(f"painted_{number}", colour**2.2, None)
    return first + index


def _base_colour(material: GltfEntry | None) -> np.ndarray:
    """(3,) linear RGB of a material, white where nothing is said."""
    factor = None if material is None else material.entry("pbrMetallicRoughness").numbers("baseColorFactor", 4)
    return np.clip((factor or (1, 1, 1))[:3], 0, 1)


def _base_picture(material: GltfEntry) -> GltfEntry | None:
    """What a material says of its base colour's texture, if it has one."""
    shading = material.entry("pbrMetallicRoughness")
    return shading.entry("baseColorTexture") if "baseColorTexture" in shading else None


def _add_material(
    library: MaterialLibrary, file: GltfFile, material: GltfEntry, index: int, warn: Callable[[str], None]
) -> int:
    """Its number in the library; materials of one name are told apart."""
    name = library.plain_name(material.text("name") or f"material_{index}")
    name = f"{name}_{index}" if name in library.names else name
    content, used = None, _base_picture(material)
    if used is not None:
        texture = file.document.item("textures", used.integer("index"))
        try:
            content = _readable(_picture_content(file, texture))
        except ContentError as error:
            warn(f"material {name!r} is shown without its picture: {error}")
    return library.add(name, _base_colour(material), content)


def _picture_content(file: GltfFile, texture: GltfEntry) -> bytes:
    """The file of a texture's picture; empty where it has none. Raises ContentError."""
    source = texture.entry("extensions").entry(WEBP).index("source")
    source = texture.index("source") if source is None else source
    return b"" if source is None else file.picture(source)


def _readable(content: bytes) -> bytes:
    """A picture as PNG or JPEG. Raises ContentError where it cannot be made one."""
    if picture_kind(content) is not None:
        return content
    try:
        from PIL import Image

        buffer = io.BytesIO()
        Image.open(io.BytesIO(content)).save(buffer, format="PNG")
    except Exception as error:  # whatever pillow trips over, or there is none
        raise ContentError("it is neither PNG nor JPEG, nor WebP that pillow reads") from error
    return buffer.getvalue()
