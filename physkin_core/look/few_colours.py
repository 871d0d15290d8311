"""Few colours that stand for many.

Dimensions: `f` faces, `k` colours.
"""

from __future__ import annotations

import numpy as np

__all__ = ["few_colours"]

ROUNDS = 20


def few_colours(colours: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """At most so many colours that stand for those of faces (f, 3): (k, 3), and which (f,) each face has."""
    from scipy.cluster.vq import kmeans2

    different, index = np.unique(colours.round(2), axis=0, return_inverse=True)
    if len(different) <= most:
        return different, index.reshape(-1)
    centres, nearest = kmeans2(colours, most, iter=ROUNDS, minit="++", rng=0)
    used, index = np.unique(nearest, return_inverse=True)
    return centres[used], index.reshape(-1)
