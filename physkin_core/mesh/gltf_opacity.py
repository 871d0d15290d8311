"""Which faces of a glTF primitive are seen: a material may let what is behind it show through, all over or where its
picture is clear, as between the lashes on a card."""

from __future__ import annotations

import numpy as np

from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_scene import Drawn, material_of
from physkin_core.mesh.gltf_look import base_picture, picture_content, texture_places
from physkin_core.mesh.picture_samples import sampled_picture

__all__ = ["seen_faces", "shows_through"]

CLEAR = 1 / 3
"""Opacity below which a face is left out of pictures, which draw no clear ones."""


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
    used = base_picture(material)
    if used is not None:
        content = picture_content(file, file.document.item("textures", used.integer("index")))
        uv = texture_places(file, drawn, material)[drawn.faces]
        opacity *= sampled_picture(content, uv, "A").mean(axis=0)
    return opacity
