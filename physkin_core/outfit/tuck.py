"""A tucked hem: what of a garment is worn under the waistband of the layer over it.

Dimensions: `n` vertices of the tucked layer, `r` of the one over it. Metres.
"""

from __future__ import annotations

import numpy as np

from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_paths import HEM, openings, path_lengths
from physkin_core.quality import closest_points

__all__ = ["DEEP", "SLIDES", "tucked_depths"]

BELOW = 0.002
"""[m] below the waistband from where cloth is tucked."""
GOES_OVER = 0.015
"""[m] Cloth that goes over a waistband has vertices at most this far below it."""
DEEP = 0.12
"""[m] below the waistband from where nobody sees tucked cloth: with a raised arm it slides up by 10 cm."""
SLIDES = 0.04
"""[m] by which tucked cloth slides up in everyday motion, beyond what everyday poses show."""
FARTHEST = 0.2
"""[m] Cloth farther from the layer over it at rest is not tucked into it."""


def tucked_depths(rest: tuple[np.ndarray, np.ndarray], faces: tuple[np.ndarray, np.ndarray]) -> np.ndarray | None:
    """How far below a waistband (n,) [m] each vertex of a layer is to be worn, 0 above; None where it does not go over
    the waistband, or where there is none as the garment is open down to its hem.

    rest: vertices (n, 3) of the layer and (r, 3) [m] of the one over it, at rest. faces: (f, 3) of these.
    """
    waistband = openings(rest[1], faces[1])[:1]
    if not waistband or rest[1][waistband[0], 2].min() < rest[1][:, 2].min() + HEM:
        return None  # that of an open front runs down to the hem: it takes no hem
    cloth, over = (np.ascontiguousarray(x, dtype=np.float64) for x in rest)
    distance, face, share = closest_points(cloth, over, faces[1])
    corners = faces[1][face]
    depth = (share * path_lengths(over, faces[1], waistband[0])[corners]).sum(axis=1)
    outward = np.einsum("nk,nki->ni", share, vertex_normals(over, faces[1])[corners])
    alike = np.einsum("ni,ni->n", outward, vertex_normals(cloth, faces[0])) > 0
    depth = np.where((distance < FARTHEST) & alike & (depth > BELOW), depth, 0)
    return depth if ((depth > 0) & (depth < GOES_OVER)).any() else None
