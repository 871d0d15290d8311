"""A glTF scene while it grows: meshes, their materials and skins. Arrays come in our root frame.

Dimensions: `v` vertices of a mesh, `f` its faces, `j` joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.export.morph_targets import MorphTargets
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, strongest_influences
from physkin_core.mesh.surfaces import Part, Picture, Surface, split_at_seams
from physkin_core.model.garment import vertex_normals

__all__ = ["GltfScene", "in_gltf_frame"]

TRANSFORM, SHEEN = "KHR_texture_transform", "KHR_materials_sheen"
SHEEN_ROUGHNESS = 0.5


def in_gltf_frame(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of the root frame in glTF's, float32."""
    return (vectors @ FROM_ROOT_FRAME.T).astype(np.float32)


class GltfScene:
    """nodes, meshes: of the document. roots: indices of nodes of the scene that hang on nothing. builder: of a document
    with a scene to add to; default a new one."""

    def __init__(self, builder: GltfBuilder | None = None) -> None:
        new = {"scene": 0, "scenes": [{"nodes": []}]}
        self.builder = builder or GltfBuilder({"generator": "PhySkin"})
        document = self.builder.document = (new if builder is None else {}) | self.builder.document
        lists = ("nodes", "meshes", "materials", "images", "textures")
        self.nodes, self.meshes, self._materials, images, textures = (document.get(key) or [] for key in lists)
        document |= {"nodes": self.nodes, "meshes": self.meshes, "materials": self._materials}
        self.roots: list[int] = document["scenes"][document.get("scene") or 0].setdefault("nodes", [])
        self._images, self._textures = images, textures
        self._pictures: dict[Picture, int] = {}

    def add_mesh(
        self,
        part: Part,
        cloud: np.ndarray,
        *,
        attributes: Mapping[str, np.ndarray] | None = None,
        morphs: MorphTargets | None = None,
        **node: Any,
    ) -> None:
        """A mesh and the node that has it, with other properties of that. cloud: (v, 6) positions and unit normals, of
        which those that no face uses are left out. attributes: what else vertices have, (v, ...) each. morphs: of its
        vertices."""
        add = self.builder.add_accessor
        stored = {}
        if part.look is None:
            own, faces = np.unique(part.faces, return_inverse=True)
            faces = faces.reshape(-1, 3)
        else:
            own, places, faces = split_at_seams(part.look, part.faces)
            stored["TEXCOORD_0"] = add((places * [1, -1] + [0, 1]).astype(np.float32))
        stored["POSITION"] = add(in_gltf_frame(cloud[own, :3]))
        stored["NORMAL"] = add(in_gltf_frame(cloud[own, 3:]))
        for key, values in (attributes or {}).items():
            stored[key] = add(values[own], normalized=key.startswith("WEIGHTS"))
        mesh: dict = {"name": part.name}
        targets = {}
        if morphs is not None:
            morphs = morphs.of_vertices(own)
            targets = {"targets": self._add_targets(morphs, len(own))}
            kind = "order" if morphs.turns is None else "fold"
            names = [f"{kind}_{k}" for k in range(len(morphs.targets))]
            mesh |= {"weights": morphs.resting.tolist(), "extras": {"targetNames": names}}
        mesh["primitives"] = [
            {
                "attributes": stored,
                "indices": add(faces[surface.faces].astype(np.uint32).reshape(-1)),
                "material": self._add_material(surface),
                **targets,
            }
            for surface in part.surfaces
        ]
        self.roots.append(len(self.nodes))
        self.nodes.append({"name": part.name, "mesh": len(self.meshes), **node})
        self.meshes.append(mesh)

    def add_body(self, avatar: Avatar, part: Part, **node: Any) -> None:
        """Some of an avatar's faces, on the skin that `node` names."""
        joints, weights = strongest_influences(avatar.influence_bones, avatar.influence_weights)
        cloud = np.concatenate([avatar.vertices, vertex_normals(avatar.vertices, avatar.faces)], axis=1)
        self.add_mesh(part, cloud, attributes={"JOINTS_0": joints, "WEIGHTS_0": weights}, **node)

    def add_skin(self, name: str, joints: Sequence[int], rest: np.ndarray) -> int:
        """Meshes are bound where unturned joints, indices of nodes, are at `rest` (j, 3). Returns the skin's index."""
        bind = np.tile(np.eye(4, dtype=np.float32), (len(rest), 1, 1))
        bind[:, 3, :3] = -in_gltf_frame(rest)  # column by column
        inverse = self.builder.add_accessor(bind.reshape(-1, 16))
        skins = self.builder.document.setdefault("skins", [])
        skins.append({"name": name, "joints": list(joints), "inverseBindMatrices": inverse})
        return len(skins) - 1

    def _add_targets(self, morphs: MorphTargets, count: int) -> list[dict[str, int]]:
        """Of a mesh of so many vertices."""
        changes = {"POSITION": morphs.targets, "NORMAL": morphs.turns}
        targets: list[dict[str, int]] = [{} for _ in morphs.targets]
        for name, values in changes.items():
            for target, each in zip(targets, () if values is None else in_gltf_frame(values)):
                target[name] = self.builder.add_sparse_accessor(morphs.moved, each, count)
        return targets

    def _add_material(self, surface: Surface) -> int:
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
        if picture not in self._pictures:
            view = self.builder.add_view(np.frombuffer(picture.content, dtype=np.uint8))
            self._pictures[picture] = len(self._textures)
            self._textures.append({"source": len(self._images)})
            self._images.append({"name": picture.name, "mimeType": picture.kind, "bufferView": view})
            self.builder.document |= {"images": self._images, "textures": self._textures}
        texture = {"index": self._pictures[picture]}
        if repeats == (1.0, 1.0):
            return texture
        scale = {"scale": list(repeats), "offset": [0.0, 1.0 - repeats[1]]}
        return {**texture, "extensions": self._extension(TRANSFORM, scale)}

    def _extension(self, name: str, content: dict) -> dict:
        """An entry of `extensions`; the document says that it is used."""
        used = self.builder.document.setdefault("extensionsUsed", [])
        used[:] = sorted({*used, name})
        return {name: content}
