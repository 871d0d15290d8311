"""A dressed avatar as surfaces to draw: skin that cloth does not cover, garments in the colours of their layers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import Mesh, layer_colours

__all__ = ["dressed_meshes"]


def dressed_meshes(outfit: Outfit, body: np.ndarray, cloth: Sequence[np.ndarray]) -> list[Mesh]:
    """Surfaces of one frame. body: (V, 3) the avatar's vertices; cloth: (v, 3 or more) of each garment, positions
    first; all [m] in one frame with Z up."""
    several = len(cloth) > 1
    skin = outfit.avatar.faces[~outfit.body_mask] if several else outfit.avatar.faces
    worn = [Mesh(np.asarray(p)[:, :3], f, c) for p, f, c in zip(cloth, outfit.faces, layer_colours(len(cloth)))]
    return [Mesh(body, skin), *worn]
