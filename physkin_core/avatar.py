"""Avatar: a body of any topology in the garment model's canonical pose, bound to the garment model's rig.

Dimensions: `V` body vertices, `f` faces, `b` bones of the garment model's rig, `K` influences. Metres, root frame
(REP-103: X forward, Y left, Z up), root at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.body_model import BodyModel
from physkin_core.rig import Rig

__all__ = ["BUNDLED_AVATAR", "Avatar", "AvatarError", "avatar_from_body", "load_avatar"]

BUNDLED_AVATAR = Path(__file__).parent / "assets" / "avatar.glb"
"""A sampled adult as GLB, to try things on."""


GLTF_SUFFIXES = (".glb", ".gltf", ".vrm")
MESH_SUFFIXES = (".obj", ".ply", ".stl")


class AvatarError(ValueError):
    """An avatar file cannot be read, is malformed, or does not fit the garment model's rig."""


@dataclass(frozen=True)
class Avatar:
    """One body at the canonical pose.

    vertices: (V, 3) float32 [m]; faces: (f, 3) int32, counter-clockwise seen from outside.
    bone_heads, bone_tails: (b, 3) float32 [m], the bones of the garment model's rig on this body.
    influence_bones: (V, K) int32 into the rig's bones; influence_weights: (V, K) float32, rows sum to 1.
    source: where it came from. warnings: what was assumed or repaired on the way, for the user to read.
    """

    vertices: np.ndarray
    faces: np.ndarray
    bone_heads: np.ndarray
    bone_tails: np.ndarray
    influence_bones: np.ndarray
    influence_weights: np.ndarray
    source: str
    warnings: tuple[str, ...] = ()

    def posed_vertices(self, bone_transforms: np.ndarray) -> np.ndarray:
        """Body surface in a pose, by linear blend skinning.

        bone_transforms: (b, 3, 4) from `Rig.bone_transforms(..., heads=self.bone_heads)`. Returns (V, 3) [m].
        """
        matrices = np.asarray(bone_transforms, dtype=np.float32)
        if matrices.shape != (len(self.bone_heads), 3, 4):
            raise ValueError(f"bone transforms have shape {matrices.shape}, expected ({len(self.bone_heads)}, 3, 4)")
        blended = np.einsum("vk,vkij->vij", self.influence_weights, matrices[self.influence_bones])
        return np.einsum("vij,vj->vi", blended[..., :3], self.vertices) + blended[..., 3]


def load_avatar(path: str | Path, rig: Rig, *, rig_file: str | Path | None = None) -> Avatar:
    """Read an avatar and put it into the canonical pose of `rig`.

    path: GLB, glTF or VRM with a skin, or an OBJ, PLY or STL mesh. rig: the garment model's.
    rig_file: skeleton of a plain mesh (layout: `physkin_core.avatar_mesh`), default `NAME.rig.json` beside `NAME.obj`
    if that exists. A mesh without any skeleton gets the rig fitted to it, and a warning that says so.
    Raises AvatarError naming what is wrong with the file and what was allowed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in GLTF_SUFFIXES + MESH_SUFFIXES:
        raise AvatarError(
            f"avatar {path} has the unknown extension {path.suffix!r}; "
            f"allowed: {', '.join(GLTF_SUFFIXES + MESH_SUFFIXES)}"
        )
    if not path.is_file():
        raise AvatarError(f"avatar {path}: no such file")
    if suffix in GLTF_SUFFIXES:
        from physkin_core.avatar_gltf import load_gltf

        return load_gltf(path, rig, rig_file=rig_file)
    from physkin_core.avatar_mesh import load_mesh

    return load_mesh(path, rig, rig_file=rig_file)


def avatar_from_body(body_model: BodyModel, coefficients: np.ndarray) -> Avatar:
    """The body of the compact body model with shape coefficients (c,); its rig must be the garment model's."""
    coefficients = np.asarray(coefficients, dtype=np.float32)
    expected = (len(body_model.vertex_components),)
    if coefficients.shape != expected or not np.isfinite(coefficients).all():
        raise AvatarError(f"shape coefficients must be {expected[0]} finite numbers, got shape {coefficients.shape}")
    heads, tails = body_model.bones(coefficients)
    return Avatar(
        vertices=body_model.vertices(coefficients).astype(np.float32),
        faces=body_model.faces,
        bone_heads=heads.astype(np.float32),
        bone_tails=tails.astype(np.float32),
        influence_bones=body_model.influence_bones,
        influence_weights=body_model.influence_weights,
        source="compact body model",
    )
