"""Avatar: a body of any topology in the garment model's canonical pose, bound to the garment model's rig.

Dimensions: `V` body vertices, `f` faces, `b` bones of the garment model's rig, `K` influences. Metres, root frame
(REP-103: X forward, Y left, Z up), root at the origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physkin_core.avatar.body_model import BodyModel
from physkin_core.rig.linear_blend_skinning import joined_influences, linear_blend_skinning

__all__ = ["Avatar", "AvatarError", "AvatarWarning", "avatar_from_body", "joined_surfaces"]


class AvatarError(ValueError):
    """An avatar file cannot be read, is malformed, or does not fit the garment model's rig."""


class AvatarWarning(UserWarning):
    """An avatar file was repaired or guessed at, or a garment does not sit well. `Avatar.warnings` keeps it."""


@dataclass(frozen=True, eq=False)
class Avatar:
    """One body in the canonical pose.

    Attributes:
        vertices: (V, 3) float32 [m].
        faces: (f, 3) int32, counter-clockwise seen from outside.
        bone_heads, bone_tails: (b, 3) float32 [m], the bones of the garment model's rig on this body.
        influence_bones: (V, K) int32, indices of the rig's bones.
        influence_weights: (V, K) float32, rows sum to 1.
        source: where it came from.
        warnings: what was assumed or repaired on the way, for the user to read.
        bone_names: (b,) of the rig that it is bound to. If empty, `Draper` can only compare the number of bones.
        file_vertices: (V, 3) float64, the vertices in the file's own frame and unit, in the pose that it shows; None if
            there is no file.
        file_corners: (f, 3) int, for each corner of `faces` the index of that triangle corner in the file, counted over
            the whole file, for looking up texture coordinates.
        file_joints: (b,) of each bone the node of a glTF file that is its joint, -1 for none; None of other files.
        file_joint_frames: (b, 4, 4) from the frame of that node, in its unit, to the root frame in the canonical pose
            [m], NaN for none. Where a clip puts the node at a transform A, the bone moves by A times its inverse.
        accessories: hair, eyes, glasses and the like, on the same bones. Pictures show them; garments ignore them.
        clothes: what it wears already, one surface each, on the same bones. Pictures show what an outfit does not
            replace.

    Examples:
        >>> avatar = physkin.load_avatar("me.glb", physkin.load_garment_model("tshirt").rig)
        >>> len(avatar.bone_heads), avatar.vertices.shape[1]
        (36, 3)
    """

    vertices: np.ndarray
    faces: np.ndarray
    bone_heads: np.ndarray
    bone_tails: np.ndarray
    influence_bones: np.ndarray
    influence_weights: np.ndarray
    source: str
    warnings: tuple[str, ...] = ()
    bone_names: tuple[str, ...] = ()
    file_vertices: np.ndarray | None = None
    file_corners: np.ndarray | None = None
    file_joints: np.ndarray | None = None
    file_joint_frames: np.ndarray | None = None
    accessories: Avatar | None = None
    clothes: tuple[Avatar, ...] = ()

    def posed_vertices(self, bone_transforms: np.ndarray) -> np.ndarray:
        """Body surface in a pose, by linear blend skinning.

        Args:
            bone_transforms: (b, 3, 4) from `Draper.bone_transforms`, or `Rig.bone_transforms(...,
                heads=self.bone_heads)`.

        Returns:
            (V, 3) [m].
        """
        matrices = np.asarray(bone_transforms, dtype=np.float32)
        if matrices.shape != (len(self.bone_heads), 3, 4):
            raise ValueError(f"bone transforms have shape {matrices.shape}, expected ({len(self.bone_heads)}, 3, 4)")
        return linear_blend_skinning(self.vertices, matrices, self.influence_bones, self.influence_weights)

    def with_accessories(self) -> Avatar:
        """One surface to draw: the body first, then its accessories and its clothes."""
        more = [*([] if self.accessories is None else [self.accessories]), *self.clothes]
        if not more:
            return self
        return replace(joined_surfaces([self, *more]), accessories=None, clothes=())


def joined_surfaces(avatars: Sequence[Avatar]) -> Avatar:
    """Surfaces on the same bones as one, the first avatar's in all else; of its file it knows no places."""
    starts = np.cumsum([0, *(len(each.vertices) for each in avatars[:-1])])
    return replace(
        avatars[0],
        vertices=np.concatenate([each.vertices for each in avatars]),
        faces=np.concatenate([each.faces + start for each, start in zip(avatars, starts)], dtype=np.int32),
        influence_bones=joined_influences([each.influence_bones for each in avatars]),
        influence_weights=joined_influences([each.influence_weights for each in avatars]),
        file_vertices=None,
        file_corners=np.concatenate([each.file_corners for each in avatars]),
    )


def avatar_from_body(body_model: BodyModel, coefficients: np.ndarray) -> Avatar:
    """A body of the body model.

    Args:
        body_model: from `load_body_model`. Its rig must be the garment model's.
        coefficients: (c,) shape coefficients.

    Returns:
        The body as an avatar.

    Examples:
        >>> bodies = physkin.load_body_model()
        >>> stranger = physkin.avatar_from_body(bodies, bodies.held_out_bodies[0])
    """
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
        bone_names=body_model.rig.bone_names,
    )
