"""Avatars unlike the bodies that garments know: pivots elsewhere in the flesh, and stylised proportions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from physkin_core import Avatar, BodyModel


def remeshed(avatar: Avatar, seed: int) -> Avatar:
    """The same surface with a quarter of its faces cut into four, in another order."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(avatar.faces), len(avatar.faces) // 4, replace=False)
    extra = np.concatenate([avatar.influence_bones, avatar.influence_weights], axis=1)
    vertices, faces = trimesh.remesh.subdivide(avatar.vertices, avatar.faces, face_index=chosen)
    from scipy.spatial import cKDTree

    own = extra[cKDTree(avatar.vertices).query(vertices)[1]]
    order = rng.permutation(len(vertices))
    place = np.argsort(order)
    width = avatar.influence_bones.shape[1]
    return replace(
        avatar,
        vertices=vertices[order].astype(np.float32),
        faces=place[rng.permutation(faces)].astype(np.int32),
        influence_bones=own[order, :width].astype(np.int32),
        influence_weights=own[order, width:].astype(np.float32),
    )


def with_odd_pivots(avatar: Avatar, seed: int) -> Avatar:
    """The same skin with every bone but the root 2 to 6 cm elsewhere, in any direction."""
    rng = np.random.default_rng(seed)
    shift = rng.normal(size=avatar.bone_heads.shape)
    shift *= rng.uniform(0.02, 0.06, (len(shift), 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    shift[0] = 0
    shift = shift.astype(np.float32)
    return replace(avatar, bone_heads=avatar.bone_heads + shift, bone_tails=avatar.bone_tails + shift)


def stylised(avatar: Avatar, body: BodyModel) -> Avatar:
    """Thin limbs, wide shoulders, short legs and a big head: parts scaled about their bones, skin blended between."""
    names, parents = body.rig.bone_names, body.rig.parents
    heads, tails = avatar.bone_heads.astype(float), avatar.bone_tails.astype(float)
    moved_heads, matrices = heads.copy(), np.tile(np.eye(3), (len(names), 1, 1))
    for bone, name in enumerate(names):
        if bone:
            offset = matrices[parents[bone]] @ (heads[bone] - heads[parents[bone]])
            if name.startswith("upperarm01"):
                offset[1] *= 1.4
            moved_heads[bone] = moved_heads[parents[bone]] + offset
        along, length = tails[bone] - heads[bone], np.linalg.norm(tails[bone] - heads[bone])
        along = along / max(length, 1e-9)
        thinner = 0.8 * np.eye(3) + 0.2 * np.outer(along, along)
        if "arm" in name or "wrist" in name:
            matrices[bone] = thinner
        elif "leg" in name or "foot" in name:
            matrices[bone] = thinner @ np.diag([1, 1, 0.8])
        elif name == "head":
            matrices[bone] = 1.4 * np.eye(3)
    translation = moved_heads - np.einsum("bij,bj->bi", matrices, heads)
    transforms = np.concatenate([matrices, translation[..., None]], axis=2).astype(np.float32)
    moved_tails = np.einsum("bij,bj->bi", matrices, tails) + translation
    return replace(
        avatar,
        vertices=avatar.posed_vertices(transforms).astype(np.float32),
        bone_heads=moved_heads.astype(np.float32),
        bone_tails=moved_tails.astype(np.float32),
    )
