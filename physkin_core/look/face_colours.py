"""One colour a face, read off the pictures of a look: for what draws no textures.

Dimensions: `f` faces.
"""

from __future__ import annotations

import logging
from functools import lru_cache

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.look.avatar_look import avatar_look
from physkin_core.mesh.look import Look
from physkin_core.mesh.picture_samples import sampled_picture
from physkin_core.mesh.surfaces import Surface, surfaces_of
from physkin_core.pictures.picture import BODY_COLOUR, pillow

__all__ = ["avatar_colours", "face_colours"]

log = logging.getLogger(__name__)


@lru_cache(maxsize=4)  # a film asks for the same avatar in every frame
def avatar_colours(avatar: Avatar) -> np.ndarray | None:
    """(f, 3) sRGB in [0, 1] of an avatar's faces by its own file; None where that has no materials.

    Raises PictureError where pictures need pillow.
    """
    look = avatar_look(avatar)
    return None if look is None else face_colours(look, BODY_COLOUR)


def face_colours(look: Look, colour: tuple[float, float, float]) -> np.ndarray:
    """(f, 3) sRGB in [0, 1] of a look's faces. colour: sRGB, of faces without a material. A damaged picture is left out
    and logged."""
    found = np.empty((len(look.material), 3))
    for surface in surfaces_of(look, "plain", colour, len(found)):
        found[surface.faces] = surface.colour * _picture_colours(surface, look.uv[surface.faces])
    return found ** (1 / 2.2)


def _picture_colours(surface: Surface, uv: np.ndarray) -> np.ndarray:
    """(k, 3) linear RGB of faces with texture coordinates (k, 3, 2); ones without a picture."""
    if surface.picture is None:
        return np.ones((len(uv), 3))
    pillow()
    try:
        samples = sampled_picture(surface.picture.content, uv * surface.repeats, "RGB")
    except Exception as error:  # whatever pillow trips over: damaged files, some too large
        log.warning("picture %s is left out: %s", surface.picture.name, error)
        return np.ones((len(uv), 3))
    return (samples**2.2).mean(axis=0)
