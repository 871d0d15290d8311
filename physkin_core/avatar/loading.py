"""Loading an avatar: from the file that a user names to a body in the garment model's canonical pose."""

from __future__ import annotations

import warnings
from pathlib import Path

from physkin_core.avatar.avatar import Avatar, AvatarError, AvatarWarning
from physkin_core.avatar.gltf_avatar import load_gltf
from physkin_core.avatar.mesh_avatar import load_mesh
from physkin_core.file_reading import ContentError, reading, sentence, shown
from physkin_core.rig.rig import Rig, RigError

__all__ = ["BUNDLED_AVATAR", "GLTF_SUFFIXES", "load_avatar"]

BUNDLED_AVATAR = Path(__file__).parents[1] / "assets" / "avatar.glb"
"""A sampled adult as GLB, to try things on."""

GLTF_SUFFIXES = (".glb", ".gltf", ".vrm", ".fbx")
"""Of glTF, and what is read as such."""
MESH_SUFFIXES = (".obj", ".ply", ".stl")


def load_avatar(
    path: str | Path, rig: Rig, *, rig_file: str | Path | None = None, bones: str | Path | None = None
) -> Avatar:
    """Read an avatar and put it into the canonical pose of a rig.

    Clothes over skin go to `Avatar.clothes`; hair, eyes and shoes to `Avatar.accessories`. What was assumed or repaired
    is kept in `Avatar.warnings`, and issued as one AvatarWarning each.

    Args:
        path: GLB, glTF, VRM or FBX with a skin, or an OBJ, PLY or STL mesh; in any of the usual units, whichever
            axis is up.
        rig: the garment model's.
        rig_file: skeleton of a plain mesh (docs/avatars.md#rig-file). None: `NAME.rig.json` beside `NAME.obj`, if it
            exists. A mesh without any skeleton gets the rig fitted to it, with a warning.
        bones: which joint is which bone, a JSON file (docs/avatars.md#bones-file). None: `NAME.bones.json` beside
            `NAME.glb`, if it exists.

    Returns:
        The avatar, bound to the rig.

    Raises:
        AvatarError: naming what is wrong with the file and what is allowed.

    Examples:
        >>> avatar = physkin.load_avatar("me.glb", physkin.load_garment_model("tshirt").rig)
        >>> avatar.warnings
        ()
    """
    path = Path(path)
    with reading(f"avatar {path}", AvatarError):
        avatar = _load(path, rig, rig_file=rig_file, bones=bones)
    for warning in avatar.warnings:
        warnings.warn(sentence(f"avatar {path}: {warning}"), AvatarWarning, stacklevel=2)
    return avatar


def _load(path: Path, rig: Rig, **skeleton: str | Path | None) -> Avatar:
    suffix = path.suffix.lower()
    if suffix not in GLTF_SUFFIXES + MESH_SUFFIXES:
        allowed = ", ".join(GLTF_SUFFIXES + MESH_SUFFIXES)
        raise ContentError(f"the extension {shown(path.suffix)} is unknown; allowed: {allowed}")
    try:
        if suffix in GLTF_SUFFIXES:
            return load_gltf(path, rig, **skeleton)
        return load_mesh(path, rig, **skeleton)
    except RigError as error:
        raise AvatarError(str(error)) from error
