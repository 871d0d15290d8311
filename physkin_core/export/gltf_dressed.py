"""An avatar and its garments as glTF 2.0 for a page that computes the cloth itself: the body on its skeleton at the
canonical pose, and of the garments how they look.

Which vertex of its garment each vertex of a mesh lies on is in the attribute `_VERTEX`, since textures need some twice;
what finishes a garment, stitches and hems, is a mesh raised by `_ABOVE` [m] along the normals. Extras of a node say
which `garment` it is of, from the skin outwards, or whether this part of the body is `covered` in all everyday poses.
Dimensions: `b` bones, `v` vertices of a mesh, `f` its faces. Metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from physkin_core.export.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, glb, strongest_influences
from physkin_core.export.gltf_materials import GltfMaterials
from physkin_core.look.avatar_look import avatar_look
from physkin_core.look.cloth_look import ClothLook, cloth_colours
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import Surface, linear, split_at_seams, surfaces_of
from physkin_core.model.garment import vertex_normals
from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import BODY_COLOUR
from physkin_core.runtime.layer import Layer

__all__ = ["dressed_glb"]


def dressed_glb(outfit: Outfit, looks: Sequence[Look | None]) -> bytes:
    """A .glb of `outfit.body_to_draw` and of what is given of its garments. looks: one a garment, as of
    `garment_looks`."""
    scene = _Scene()
    scene.add_body(outfit)
    for garment, (layer, colour, look) in enumerate(zip(outfit.layers, cloth_colours(outfit.garments), looks)):
        scene.add_garment(garment, layer, colour, look)
    return glb(scene.finished())


@dataclass(frozen=True)
class _Mesh:
    """cloud: (v, 6) positions and unit normals. faces: (f, 3). attributes: (v, ...) what else vertices have. extras:
    of its node. skin: whether it is skinned to the bones."""

    name: str
    cloud: np.ndarray
    faces: np.ndarray
    extras: Mapping[str, int | bool]
    attributes: Mapping[str, np.ndarray] = field(default_factory=dict)
    skinned: bool = False


class _Scene:
    """A document while it grows."""

    def __init__(self) -> None:
        self._builder = GltfBuilder({"generator": "PhySkin"})
        self._materials = GltfMaterials(self._builder)
        self._nodes: list[dict] = []
        self._meshes: list[dict] = []
        self._roots: list[int] = []

    def add_body(self, outfit: Outfit) -> None:
        """Bones as nodes, called as in the rig and unturned, and on them what of the body is seen, and what is not."""
        avatar, rig = outfit.body_to_draw, outfit.rig
        heads = avatar.bone_heads @ FROM_ROOT_FRAME.T
        for bone, (name, parent) in enumerate(zip(rig.bone_names, rig.parents)):
            siblings = self._nodes[parent].setdefault("children", []) if parent >= 0 else self._roots
            siblings.append(bone)
            place = heads[bone] - heads[parent] if parent >= 0 else heads[bone]
            self._nodes.append({"name": name, "translation": place.tolist()})
        bind = np.tile(np.eye(4, dtype=np.float32), (len(heads), 1, 1))
        bind[:, 3, :3] = -heads  # column by column
        inverse = self._builder.add_accessor(bind.reshape(-1, 16))
        self._builder.document["skins"] = [{"joints": list(range(len(heads))), "inverseBindMatrices": inverse}]
        joints, weights = strongest_influences(avatar.influence_bones, avatar.influence_weights)
        cloud = np.concatenate([avatar.vertices, vertex_normals(avatar.vertices, avatar.faces)], axis=1)
        for name, shown in (("body", outfit.faces_to_draw), ("covered", ~outfit.faces_to_draw)):
            mesh = _Mesh(
                name,
                cloud,
                avatar.faces[shown],
                extras={"covered": name == "covered"},
                attributes={"JOINTS_0": joints, "WEIGHTS_0": weights},
                skinned=True,
            )
            look = avatar_look(avatar, shown)
            self._add(mesh, look, surfaces_of(look, "body", linear(BODY_COLOUR), len(mesh.faces)))

    def add_garment(self, garment: int, layer: Layer, colour: tuple[float, float, float], look: Look | None) -> None:
        """What is given of it, and what finishes it. colour: sRGB, of what has no material."""
        cloud, extras = layer.rest[layer.visible], {"garment": garment}
        own = {"_VERTEX": np.arange(len(cloud))}
        surfaces = surfaces_of(look, layer.name, linear(colour), len(layer.faces))
        self._add(_Mesh(layer.name, cloud, layer.faces, extras, own), look, surfaces)
        for finish, surface in look.finishes if isinstance(look, ClothLook) else ():
            on = {"_VERTEX": finish.vertices, "_ABOVE": finish.above}
            mesh = _Mesh(f"{layer.name} {surface.name}", finish.on(cloud), finish.faces, extras, on)
            whole = replace(surface, faces=np.arange(len(finish.faces)))
            self._add(mesh, Look.with_places(finish.places), [whole])

    def finished(self) -> GltfBuilder:
        """The document, whole."""
        self._materials.finish()
        self._builder.document |= {
            "scene": 0,
            "scenes": [{"nodes": self._roots}],
            "nodes": self._nodes,
            "meshes": self._meshes,
        }
        return self._builder

    def _add(self, mesh: _Mesh, look: Look | None, surfaces: Sequence[Surface]) -> None:
        """A mesh by its materials; nothing where it has no faces."""
        if not len(mesh.faces):
            return
        add, attributes = self._builder.add_accessor, {}
        if look is None:
            own, faces = np.unique(mesh.faces, return_inverse=True)
            faces = faces.reshape(mesh.faces.shape)
        else:
            own, places, faces = split_at_seams(look, mesh.faces)
            attributes["TEXCOORD_0"] = add((places * [1, -1] + [0, 1]).astype(np.float32))
        cloud = mesh.cloud[own]
        attributes["POSITION"] = add((cloud[:, :3] @ FROM_ROOT_FRAME.T).astype(np.float32))
        attributes["NORMAL"] = add((cloud[:, 3:] @ FROM_ROOT_FRAME.T).astype(np.float32))
        for name, values in mesh.attributes.items():
            kept = values[own].astype(np.float32) if name.startswith("_") else values[own]
            attributes[name] = add(kept, normalized=name.startswith("WEIGHTS"))
        primitives = [
            {
                "attributes": attributes,
                "indices": add(faces[surface.faces].astype(np.uint32).reshape(-1)),
                "material": self._materials.add(surface),
            }
            for surface in surfaces
        ]
        node = {"name": mesh.name, "mesh": len(self._meshes), "extras": dict(mesh.extras)}
        self._meshes.append({"name": mesh.name, "primitives": primitives})
        self._roots.append(len(self._nodes))
        self._nodes.append({**node, "skin": 0} if mesh.skinned else node)
