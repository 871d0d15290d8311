"""Motions draped on an outfit, as a glTF file can hold it: bones, garment nodes, morph targets for what is added to
skinning, and of body and cloth what the clip shows.

Dimensions: `T` frames, `b` bones, `m` garment nodes, `n` vertices of a garment, `v` shown, `F` faces of the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from physkin_core.export.morph_targets import MorphTargets, in_few_targets, unskinned
from physkin_core.model.garment import vertex_normals
from physkin_core.model.skinning import skinning_matrices, unit
from physkin_core.motion.motion import Motion
from physkin_core.outfit.coverage import AlwaysCovered, faces_of
from physkin_core.outfit.outfit import Outfit
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.layer import Layer

__all__ = ["DrapedClip", "DrapedGarment", "drape_clip"]


@dataclass(frozen=True)
class DrapedGarment:
    """A garment in all frames. shown: (f,) bool of its layer's faces. given: the bound garment of these, offset at
    rest, with the influences that engines take. node_transforms: (T, m, 3, 4). morphs: of vertices of `given`.
    lacking: (T, u) [m] by how much these are off."""

    name: str
    shown: np.ndarray
    given: BoundGarment
    node_transforms: np.ndarray
    morphs: MorphTargets
    lacking: np.ndarray


@dataclass(frozen=True)
class DrapedClip:
    """Frames of all motions, one after the other. bones: (T, b, 3, 4) canonical to posed. body_shown: (F,) bool of the
    faces of `Outfit.body_to_draw`. garments: from the skin outwards."""

    bones: np.ndarray
    body_shown: np.ndarray
    garments: tuple[DrapedGarment, ...]


def drape_clip(outfit: Outfit, *motions: Motion, everyday: bool = False) -> DrapedClip:
    """Drape all frames of motions, and the rest pose, in which a file lies that nothing moves.

    outfit: of models `for_engines`, those with detail as they are, and whole (`hide_covered=False`): what is covered
    in all frames is left out here, in all everyday poses if `everyday`. Detail moves every vertex besides skinning, so
    that what the few influences of engines lose is made up for by the way.
    """
    layers, rig = outfit.layers, outfit.rig
    skinned = [_for_engines(layer) for layer in layers]
    share = min(len(motions), 3)  # more motions have more folds
    always = AlwaysCovered(layers, outfit.avatar)
    always.look(rig.rest, outfit.drape(rig.rest))
    bones, nodes, added, normals = [], *([[] for _ in layers] for _ in range(3))
    for positions, time, root in chain.from_iterable(
        zip(motion.positions_for(rig), motion.times, motion.root) for motion in motions
    ):
        if time == 0:
            outfit.reset()
        clouds = outfit.drape(positions, time=time, root=root)
        always.look(positions, clouds)
        bones.append(outfit.bone_transforms(positions))
        for bound, cloud, now, *kept in zip(skinned, clouds, outfit.node_transforms(), nodes, added, normals):
            matrices = _blended(bound, now)
            kept[0].append(now)
            kept[1].append(unskinned(bound.vertices, matrices, cloud[:, :3]))
            if bound.detail_layers:
                kept[2].append(_unskinned_normals(matrices, vertex_normals(cloud[:, :3], bound.faces)))
    accessories = len(outfit.body_to_draw.faces) - len(outfit.avatar.faces)
    cloth_hidden = [layer.hidden for layer in layers] if everyday else always.cloth
    body_hidden = outfit.body_mask if everyday else faces_of(outfit.avatar.faces, always.body)
    return DrapedClip(
        bones=np.array(bones),
        body_shown=np.concatenate([~body_hidden, np.ones(accessories, dtype=bool)]),
        garments=tuple(
            _shown(layer.name, bound, ~faces_of(layer.faces, hidden), *map(np.array, recorded), share)
            for layer, bound, hidden, *recorded in zip(layers, skinned, cloth_hidden, nodes, added, normals)
        ),
    )


def _for_engines(layer: Layer) -> BoundGarment:
    """What is given of a garment, with the influences that engines take."""
    nodes, weights = layer.model.engine_nodes[layer.visible], layer.model.engine_weights[layer.visible]
    return replace(layer.bound_visible, influence_nodes=nodes, influence_weights=weights)


def _unskinned_normals(matrices: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Unit normals (v, 3) that skinning by matrices (v, 3, 4), which engines carry normals with as they are, turns to
    those wanted (v, 3)."""
    return unit(np.linalg.solve(matrices[..., :3], wanted[..., None])[..., 0]).astype(np.float32)


def _blended(bound: BoundGarment, nodes: np.ndarray, vertices: np.ndarray | slice = slice(None)) -> np.ndarray:
    """What skinning does to some vertices, (k, 3, 4), with garment nodes at (m, 3, 4)."""
    each = skinning_matrices(nodes.astype(np.float64), bound.node_rest)[bound.influence_nodes[vertices]]
    return np.einsum("vk,vkij->vij", bound.influence_weights[vertices], each)


def _shown(
    name: str,
    bound: BoundGarment,
    shown: np.ndarray,
    node_transforms: np.ndarray,
    added: np.ndarray,
    normals: np.ndarray,
    share: int,
) -> DrapedGarment:
    """A garment of which some faces are shown, and their vertices. added: (T, n, 3) to the whole one's in each frame;
    normals: (T, n, 3) that they should have before skinning, none without detail."""
    visible, faces = np.unique(bound.faces[shown], return_inverse=True)
    given = bound.of_vertices(visible, faces.reshape(-1, 3).astype(np.int32))
    morphs, offset, left = in_few_targets(added[:, visible], share)
    lacking = [
        np.linalg.norm(np.einsum("vij,vj->vi", _blended(given, nodes, morphs.moved)[..., :3], each), axis=1)
        for nodes, each in zip(node_transforms, left)
    ]
    vertices = given.vertices.copy()
    vertices[morphs.moved] += offset.astype(np.float32)
    given = replace(given, vertices=vertices)
    if len(normals):
        given = replace(given, normals=vertex_normals(vertices, given.faces))
        morphs = morphs.with_turns(given.normals[morphs.moved], normals[:, visible[morphs.moved]])
    return DrapedGarment(
        name=name,
        shown=shown,
        given=given,
        node_transforms=node_transforms,
        morphs=morphs,
        lacking=np.array(lacking),
    )
