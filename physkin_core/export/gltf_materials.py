"""Materials of a glTF document while it grows, and their pictures, which are in the file once."""

from __future__ import annotations

import numpy as np

from physkin_core.export.gltf_builder import GltfBuilder
from physkin_core.mesh.surfaces import Picture, Surface

__all__ = ["GltfMaterials"]

TRANSFORM, SHEEN = "KHR_texture_transform", "KHR_materials_sheen"
SHEEN_ROUGHNESS = 0.5


class GltfMaterials:
    """builder: of the document. `finish` is called last."""

    def __init__(self, builder: GltfBuilder) -> None:
        self._builder = builder
        self._materials: list[dict] = []
        self._pictures: dict[Picture, int] = {}
        self._extensions: set[str] = set()

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
            material["extensions"] = {SHEEN: sheen}
            self._extensions.add(SHEEN)
        if material not in self._materials:
            self._materials.append(material)
        return self._materials.index(material)

    def finish(self) -> None:
        """Put them into the document, with their pictures."""
        self._builder.document["materials"] = self._materials
        if self._pictures:
            images = [
                {"name": each.name, "mimeType": each.kind, "bufferView": view} for each, view in self._pictures.items()
            ]
            textures = [{"source": image} for image in range(len(images))]
            self._builder.document |= {"images": images, "textures": textures}
        if self._extensions:
            self._builder.document["extensionsUsed"] = sorted(self._extensions)

    def _texture_of(self, picture: Picture, repeats: tuple[float, float]) -> dict:
        """What a material says of it. glTF has the origin of texture coordinates at the upper left."""
        if picture not in self._pictures:
            self._pictures[picture] = self._builder.add_view(np.frombuffer(picture.content, dtype=np.uint8))
        texture = {"index": list(self._pictures).index(picture)}
        if repeats == (1.0, 1.0):
            return texture
        self._extensions.add(TRANSFORM)
        scale = {"scale": list(repeats), "offset": [0.0, 1.0 - repeats[1]]}
        return {**texture, "extensions": {TRANSFORM: scale}}
