"""Materials of a glTF document while it grows, and their pictures, which are in the file once."""

from __future__ import annotations

import numpy as np

from physkin_core.export.gltf_builder import GltfBuilder
from physkin_core.mesh.surfaces import Picture, Surface

__all__ = ["GltfMaterials"]

TRANSFORM, SHEEN = "KHR_texture_transform", "KHR_materials_sheen"
SHEEN_ROUGHNESS = 0.5


class GltfMaterials:
    """builder: of the document that they are written into."""

    def __init__(self, builder: GltfBuilder) -> None:
        self._builder = builder
        self._materials = builder.document.setdefault("materials", [])
        self._pictures: list[Picture] = []

    def add(self, surface: Surface) -> int:
        """The index of its material; of two that are alike, the first one's."""
        factors = {"metallicFactor": 0.0, "roughnessFactor": surface.roughness}
        shading: dict = {"baseColorFactor": [*surface.colour, 1.0], **factors}
        material = {"name": surface.name, "pbrMetallicRoughness": shading, "doubleSided": True}
        if surface.picture is not None:
            shading["baseColorTexture"] = self._texture_of(surface.picture, surface.repeats)
        if surface.normals is not None:
            material["normalTexture"] = self._texture_of(surface.normals, surface.normal_repeats)
        if surface.blended:
            material["alphaMode"] = "BLEND"
        if surface.sheen:
            sheen = {"sheenColorFactor": 3 * [surface.sheen], "sheenRoughnessFactor": SHEEN_ROUGHNESS}
            material["extensions"] = self._extension(SHEEN, sheen)
        if material not in self._materials:
            self._materials.append(material)
        return self._materials.index(material)

    def _texture_of(self, picture: Picture, repeats: tuple[float, float]) -> dict:
        """What a material says of it. glTF has the origin of texture coordinates at the upper left."""
        document = self._builder.document
        if picture not in self._pictures:
            view = self._builder.add_view(np.frombuffer(picture.content, dtype=np.uint8))
            image = {"name": picture.name, "mimeType": picture.kind, "bufferView": view}
            document.setdefault("images", []).append(image)
            document.setdefault("textures", []).append({"source": len(self._pictures)})
            self._pictures.append(picture)
        texture = {"index": self._pictures.index(picture)}
        if repeats == (1.0, 1.0):
            return texture
        scale = {"scale": list(repeats), "offset": [0.0, 1.0 - repeats[1]]}
        return {**texture, "extensions": self._extension(TRANSFORM, scale)}

    def _extension(self, name: str, content: dict) -> dict:
        """An entry of `extensions`; the document says that it is used."""
        used = self._builder.document.setdefault("extensionsUsed", [])
        used[:] = sorted({*used, name})
        return {name: content}
