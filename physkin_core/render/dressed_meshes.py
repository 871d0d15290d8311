"""A dressed avatar as surfaces to draw: skin that cloth does not cover in its own colours, garments in those of their
layers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.look.face_colours import avatar_colours
from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import BODY_COLOUR, Mesh, layer_colours

__all__ = ["dressed_meshes"]


def dressed_meshes(outfit: Outfit, body: np.ndarray, cloth: Sequence[np.ndarray]) -> list[Mesh]:
    """Surfaces of one frame. body: (V, 3) vertices of `body_to_draw`; cloth: (v, 3 or more) of each garment, positions
    first; all [m] in one frame with Z up."""
    shown = outfit.faces_to_draw if len(cloth) > 1 else slice(None)
    colours = avatar_colours(outfit.body_to_draw)
    skin = Mesh(body, outfit.body_to_draw.faces[shown], BODY_COLOUR if colours is None else colours[shown])
    worn = [
        Mesh(np.asarray(points)[:, :3], layer.faces, colour)
        for points, layer, colour in zip(cloth, outfit.layers, layer_colours(len(cloth)))
    ]
    return [skin, *worn]
