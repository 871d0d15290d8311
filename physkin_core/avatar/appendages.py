"""What a figure has that no human has: a tail, wings, ears that hang down, long hair in one mesh with the skin.

Joints that are no human's, and pieces of the surface that hang on one that is, count as such where much of their skin
lies farther from the bone than flesh does; about head and neck, where it hangs below the shoulders.

Dimensions: `V` vertices, `f` faces, `j` joints, `b` bones of the rig. Metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.body_parts import APPENDAGE, BODY, CLOTHES, UNKNOWN, kind_of_part
from physkin_core.avatar.skinned_mesh import SkinnedMesh
from physkin_core.model.surface_paths import mesh_edges, pieces
from physkin_core.rig.linear_blend_skinning import strongest_influence
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["with_appendages_apart"]

MUCH = 0.1
"""Share of the skin of joints or of a piece."""
STOUT, LOOSE = 1.5, 0.05
"""How far from a bone flesh reaches at most: over what the mean body has, and more [m]."""
BELOW = 0.03
"""[m] Below the shoulders hair hangs, and no chin."""


def with_appendages_apart(
    mesh: SkinnedMesh,
    bone_joint: Mapping[str, int],
    joint_bones: np.ndarray,
    rig: Rig,
    *,
    heads: np.ndarray,
    tails: np.ndarray,
    scale: float,
) -> SkinnedMesh:
    """The mesh with what no human has as parts of their own, named for their joints.

    joint_bones: (j,) bone of each joint. heads, tails: (b, 3) of the bones. scale: size of the skeleton over the rig's.
    """
    rigid = mesh.influence_weights.shape[1] == 1  # parts of a robot have any shape
    if rigid or rig.bone_names != load_body_model().rig.bone_names:
        return mesh
    strongest = strongest_influence(mesh.influence_joints, mesh.influence_weights)
    bones = joint_bones[strongest]
    off = _off_bones(mesh.vertices, heads[bones], tails[bones])
    shoulders = min(heads[rig.bone_index(f"upperarm01.{side}"), 2] for side in "LR")
    upper = np.array([name.startswith(("neck", "head")) for name in rig.bone_names])[bones]
    far = np.where(upper, mesh.vertices[:, 2] < shoulders - BELOW * scale, off > scale * _flesh()[bones])
    parts = np.zeros(len(mesh.faces), dtype=int) if mesh.face_parts is None else mesh.face_parts
    names = list(mesh.part_names) or [("body",)]
    skin = np.array([kind_of_part(each) in (BODY, UNKNOWN) for each in names])[parts]
    chains, found = _strange_chains(mesh, bone_joint, joint_bones, rig)[strongest], np.full(len(mesh.vertices), -1)
    for chain in np.unique(chains[chains >= 0]):
        if far[chains == chain].mean() > MUCH:
            found[chains == chain] = chain
    piece_of = pieces(mesh_edges(mesh.faces[skin])[0], len(mesh.vertices))
    largest = np.bincount(piece_of).argmax()
    share = np.bincount(piece_of, far) / np.maximum(np.bincount(piece_of), 1)
    for piece in np.flatnonzero((share > MUCH) & (np.arange(len(share)) != largest)):
        own = (piece_of == piece) & (found < 0)
        if own.any():
            found[own] = np.bincount(strongest[own]).argmax()
    faces = np.where(skin, np.sort(found[mesh.faces], axis=1)[:, 1], -1)  # that of two corners at least
    if not (faces >= 0).any() or (faces[skin] >= 0).all():
        return mesh
    for joint in np.unique(faces[faces >= 0]):
        parts = np.where(faces == joint, len(names), parts)
        own = (mesh.joint_names[joint], APPENDAGE)  # a joint of a skirt says so; one of hair may just say head
        names.append(own if kind_of_part(own[:1]) == CLOTHES else own[::-1])
    kept, parts = np.unique(parts, return_inverse=True)
    return replace(
        mesh,
        part_names=tuple(names[part] for part in kept),
        face_parts=parts.reshape(-1),
        clear_parts=frozenset(int(new) for new, part in enumerate(kept) if part in mesh.clear_parts),
    )


def _strange_chains(mesh: SkinnedMesh, bone_joint: Mapping[str, int], joint_bones: np.ndarray, rig: Rig) -> np.ndarray:
    """(j,) for joints that are no human's the first of their chain, -1 for others, and for fingers and toes."""
    parents = mesh.joint_parents
    human = {above for joint in bone_joint.values() for above in ancestors(parents, joint)}
    ends = np.array([name.startswith(("wrist", "foot")) for name in rig.bone_names])
    chains = np.full(len(parents), -1)
    for joint, parent in enumerate(parents):
        if joint not in human and not ends[joint_bones[joint]]:
            chains[joint] = chains[parent] if parent >= 0 and chains[parent] >= 0 else joint
    if "head" not in bone_joint and (chains >= 0).any():  # then it may be the topmost of these
        chains[chains == chains[np.where(chains >= 0, mesh.joint_heads[:, 2], -np.inf).argmax()]] = -1
    return chains


def _off_bones(points: np.ndarray, heads: np.ndarray, tails: np.ndarray) -> np.ndarray:
    """(V,) [m] how far each of points (V, 3) is from a bone of its own."""
    axis, away = tails - heads, points - heads
    along = np.clip((away * axis).sum(axis=1) / np.maximum((axis**2).sum(axis=1), 1e-12), 0, 1)
    return np.linalg.norm(away - along[:, None] * axis, axis=1)


@cache
def _flesh() -> np.ndarray:
    """(b,) [m] how far from each bone flesh reaches at most; shared, do not write."""
    body = load_body_model()
    bones = strongest_influence(body.influence_bones, body.influence_weights)
    usual = np.zeros(len(body.mean_bones))
    np.maximum.at(usual, bones, _off_bones(body.mean_vertices, *body.mean_bones[bones].swapaxes(0, 1)))
    return STOUT * np.where(usual > 0, usual, usual.max()) + LOOSE
