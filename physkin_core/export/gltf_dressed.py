"""An avatar and its garments as glTF 2.0 for a page that computes the cloth itself: the body on its skeleton at the
canonical pose, and of the garments how they look.

Which vertex of its garment each vertex of a mesh lies on is in the attribute `_VERTEX`, since textures need some twice;
what finishes a garment, stitches and hems, is a mesh raised by `_ABOVE` [m] along the normals. Extras of a node say
which `garment` it is of, from the skin outwards, or whether this part of the body is `covered` in all everyday poses.
Dimensions: `b` bones, `v` vertices of a mesh, `f` its faces. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physkin_core.export.gltf_builder import glb, strongest_influences
from physkin_core.export.gltf_scene import GltfScene, in_gltf_frame
from physkin_core.look.avatar_look import avatar_look
from physkin_core.look.cloth_look import ClothLook, cloth_colours
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import linear, surfaces_of
from physkin_core.model.garment import vertex_normals
from physkin_core.outfit.outfit import Outfit
from physkin_core.pictures.picture import BODY_COLOUR
from physkin_core.runtime.layer import Layer

__all__ = ["dressed_glb"]


def dressed_glb(outfit: Outfit, looks: Sequence[Look | None]) -> bytes:
    """A .glb of `outfit.body_to_draw` and of what is given of its garments. looks: one a garment, as of
    `garment_looks`."""
    scene = GltfScene()
    _add_body(scene, outfit)
    for garment, (layer, colour, look) in enumerate(zip(outfit.layers, cloth_colours(outfit.garments), looks)):
        _add_garment(scene, garment, layer, colour, look)
    return glb(scene.finished())


def _add_body(scene: GltfScene, outfit: Outfit) -> None:
    """Bones as nodes, called as in the rig and unturned, and on them what of the body is seen, and what is not."""
    avatar, rig = outfit.body_to_draw, outfit.rig
    heads = avatar.bone_heads
    for bone, (name, parent) in enumerate(zip(rig.bone_names, rig.parents)):
        siblings = scene.nodes[parent].setdefault("children", []) if parent >= 0 else scene.roots
        siblings.append(bone)
        place = heads[bone] - heads[parent] if parent >= 0 else heads[bone]
        scene.nodes.append({"name": name, "translation": in_gltf_frame(place).tolist()})
    skin = scene.add_skin("body", range(len(heads)), heads)
    joints, weights = strongest_influences(avatar.influence_bones, avatar.influence_weights)
    influences = {"JOINTS_0": joints, "WEIGHTS_0": weights}
    cloud = np.concatenate([avatar.vertices, vertex_normals(avatar.vertices, avatar.faces)], axis=1)
    for name, shown in (("body", outfit.faces_to_draw), ("covered", ~outfit.faces_to_draw)):
        if shown.any():
            look, faces = avatar_look(avatar, shown), avatar.faces[shown]
            surfaces = surfaces_of(look, "body", linear(BODY_COLOUR), len(faces))
            own = {"extras": {"covered": name == "covered"}, "skin": skin}
            scene.add_mesh(name, cloud, faces, look, surfaces, attributes=influences, **own)


def _add_garment(
    scene: GltfScene, garment: int, layer: Layer, colour: tuple[float, float, float], look: Look | None
) -> None:
    """What is given of it, and what finishes it. colour: sRGB, of what has no material."""
    cloud, extras = layer.rest[layer.visible], {"garment": garment}
    if not len(layer.faces):
        return
    surfaces = surfaces_of(look, layer.name, linear(colour), len(layer.faces))
    own = {"_VERTEX": np.arange(len(cloud), dtype=np.float32)}
    scene.add_mesh(layer.name, cloud, layer.faces, look, surfaces, attributes=own, extras=extras)
    for finish, surface in look.finishes if isinstance(look, ClothLook) else ():
        own = {"_VERTEX": finish.vertices.astype(np.float32), "_ABOVE": finish.above.astype(np.float32)}
        whole, places = replace(surface, faces=np.arange(len(finish.faces))), Look.with_places(finish.places)
        name = f"{layer.name} {surface.name}"
        scene.add_mesh(name, finish.on(cloud), finish.faces, places, [whole], attributes=own, extras=extras)
