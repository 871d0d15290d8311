"""An avatar and its garments as glTF 2.0 for a page that computes the cloth itself: the body on its skeleton at the
canonical pose, and of the garments how they look.

Which vertex of its garment each vertex of a mesh lies on is in the attribute `_VERTEX`, since textures need some twice;
what finishes a garment, stitches and hems, is a mesh raised by `_ABOVE` [m] along the normals. Extras of a node say
which `garment` it is of, from the skin outwards, or whether this part of the body is `covered` in all everyday poses.
Dimensions: `b` bones, `v` vertices of a mesh, `f` its faces. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.export.gltf_scene import GltfScene, in_gltf_frame
from physkin_core.formats.gltf_builder import glb
from physkin_core.look.avatar_look import avatar_look
from physkin_core.look.cloth_look import cloth_colours
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import parts_of
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
    return glb(scene.builder)


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
    for name, shown in (("body", outfit.faces_to_draw), ("covered", ~outfit.faces_to_draw)):
        if shown.any():
            (part,) = parts_of(avatar_look(avatar, shown), name, BODY_COLOUR, avatar.faces[shown])
            scene.add_body(avatar, part, skin=skin, extras={"covered": name == "covered"})


def _add_garment(
    scene: GltfScene, garment: int, layer: Layer, colour: tuple[float, float, float], look: Look | None
) -> None:
    """What is given of it, and what finishes it. colour: sRGB, of what has no material."""
    cloud = layer.rest[layer.visible]
    if not len(layer.faces):
        return
    for part in parts_of(look, layer.name, colour, layer.faces):
        own = {"_VERTEX": np.arange(len(cloud), dtype=np.float32)}
        if part.finish is not None:
            own = {"_VERTEX": part.finish.vertices.astype(np.float32), "_ABOVE": part.finish.above.astype(np.float32)}
        scene.add_mesh(part, part.on(cloud), attributes=own, extras={"garment": garment})
