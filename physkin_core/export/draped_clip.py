"""A motion draped on an outfit, as a glTF file can hold it: bones, garment nodes, morph targets for what is added to
skinning, and of body and cloth what the clip shows.

Dimensions: `T` frames, `b` bones, `m` garment nodes, `n` vertices of a garment, `v` shown, `F` faces of the body.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from physkin_core.export.morph_targets import MorphTargets, in_few_targets, unskinned
from physkin_core.model.skinning import skinning_matrices
from physkin_core.motion.motion import Motion
from physkin_core.outfit.coverage import AlwaysCovered, faces_of
from physkin_core.outfit.outfit import Outfit
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["DrapedClip", "DrapedGarment", "drape_clip"]


@dataclass(frozen=True)
class DrapedGarment:
    """A garment in all frames. shown: (f,) bool of its layer's faces. given: the bound garment of these, offset at
    rest. node_transforms: (T, m, 3, 4). morphs: of vertices of `given`. lacking: (T,) [m] by how much these are off,
    where they are most."""

    name: str
    shown: np.ndarray
    given: BoundGarment
    node_transforms: np.ndarray
    morphs: MorphTargets
    lacking: np.ndarray


@dataclass(frozen=True)
class DrapedClip:
    """bones: (T, b, 3, 4) canonical to posed. body_shown: (F,) bool of the faces of `Outfit.body_to_draw`. garments:
    from the skin outwards."""

    bones: np.ndarray
    body_shown: np.ndarray
    garments: tuple[DrapedGarment, ...]


def drape_clip(outfit: Outfit, motion: Motion) -> DrapedClip:
    """Drape all frames of a motion, and the rest pose, in which a file lies that nothing moves.

    outfit: of models `for_engines`, whole (`hide=False`): what is covered in all of these is left out here.
    """
    layers, rig = outfit.layers, outfit.rig
    always = AlwaysCovered(layers, outfit.avatar)
    always.look(rig.rest, outfit.drape(rig.rest))
    bones, nodes, added = [], [[] for _ in layers], [[] for _ in layers]
    outfit.reset()
    for positions, time, root in zip(motion.positions_for(rig), motion.times, motion.root):
        clouds = outfit.drape(positions, time=time, root=root)
        always.look(positions, clouds)
        bones.append(outfit.bone_transforms(positions))
        for layer, cloud, now, *kept in zip(layers, clouds, outfit.node_transforms(), nodes, added):
            kept[0].append(now)
            kept[1].append(unskinned(layer.given.vertices, _blended(layer.given, now), cloud[:, :3]))
    accessories = len(outfit.body_to_draw.faces) - len(outfit.avatar.faces)
    body_hidden = faces_of(outfit.avatar.faces, always.body)
    return DrapedClip(
        bones=np.array(bones),
        body_shown=np.concatenate([~body_hidden, np.ones(accessories, dtype=bool)]),
        garments=tuple(
            _shown(layer.name, layer.given, ~faces_of(layer.faces, hidden), np.array(each), moved)
            for layer, hidden, each, moved in zip(layers, always.cloth, nodes, added)
        ),
    )


def _blended(bound: BoundGarment, nodes: np.ndarray, vertices: np.ndarray | slice = slice(None)) -> np.ndarray:
    """What skinning does to some vertices, (k, 3, 4), with garment nodes at (m, 3, 4)."""
    each = skinning_matrices(nodes.astype(np.float64), bound.node_rest)[bound.influence_nodes[vertices]]
    return np.einsum("vk,vkij->vij", bound.influence_weights[vertices], each)


def _shown(
    name: str,
    bound: BoundGarment,
    shown: np.ndarray,
    node_transforms: np.ndarray,
    added: Iterable[tuple[np.ndarray, np.ndarray]],
) -> DrapedGarment:
    """A garment of which some faces are shown, and their vertices. added: to the whole one's, of each frame."""
    visible, faces = np.unique(bound.faces[shown], return_inverse=True)
    kept = []
    for indices, values in added:
        of = np.isin(indices, visible)
        kept.append((np.searchsorted(visible, indices[of]), values[of]))
    given = bound.of_vertices(visible, faces.reshape(-1, 3).astype(np.int32))
    morphs = in_few_targets(kept)
    lacking = [
        np.linalg.norm(np.einsum("vij,vj->vi", _blended(given, nodes, morphs.moved)[..., :3], left), axis=1)
        for nodes, left in zip(node_transforms, morphs.lacking)
    ]
    vertices = given.vertices.copy()
    vertices[morphs.moved] += morphs.offset.astype(np.float32)
    return DrapedGarment(
        name=name,
        shown=shown,
        given=replace(given, vertices=vertices),
        node_transforms=node_transforms,
        morphs=morphs,
        lacking=np.array([each.max(initial=0) for each in lacking]),
    )
