"""Limbs of the rig that end where a source's limbs end, though their segments have other lengths.

Dimensions: `T` frames. Vectors in one frame of reference, lengths in one unit.
"""

from __future__ import annotations

import numpy as np

__all__ = ["limb_towards"]

STRAIGHT = 0.05
"""Sine of the bend at which the hinge says as much of where a middle joint lies as the source's own does."""
FULL_REACH = 1 - 1e-4
"""Of a limb's length: at all of it the directions of its segments would change infinitely fast."""


def limb_towards(
    end: np.ndarray, source_upper: np.ndarray, hinge: np.ndarray, upper: float, lower: float
) -> tuple[np.ndarray, np.ndarray]:
    """Directions (T, 3) of a limb's segments, of lengths `upper` and `lower`, that lead to `end`, or towards it.

    end: (T, 3) where the limb is to end, from where it begins. source_upper: (T, 3) direction of the source's upper
    segment, on whose side the limb bends. hinge: (T, 3) axis of its middle joint, about which the lower segment turns
    from the upper one; it decides where the limb is straight.
    """
    distance = np.linalg.norm(end, axis=1, keepdims=True)
    along = end / np.maximum(distance, 1e-9)
    distance = np.clip(distance, abs(upper - lower) / FULL_REACH + 1e-9, (upper + lower) * FULL_REACH)
    aside = source_upper - along * (source_upper * along).sum(axis=1, keepdims=True)
    aside += STRAIGHT * np.cross(along, hinge)
    aside -= along * (aside * along).sum(axis=1, keepdims=True)
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-9)
    cosine = (upper**2 + distance**2 - lower**2) / (2 * upper * distance)
    first = cosine * along + np.sqrt(np.maximum(1 - cosine**2, 0)) * aside
    second = distance * along - upper * first
    return first, second / np.linalg.norm(second, axis=1, keepdims=True)
