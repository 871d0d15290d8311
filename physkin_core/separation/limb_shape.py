"""A limb as spheres along it, fitted to the skin around its bones; consecutive ones span tapered capsules.

Hands and feet are flat: two by two spheres and one at the tip. Dimensions: `V` skin points. Metres, canonical pose.
"""

from __future__ import annotations

import numpy as np

from physkin_core.body_shape.skin_by_part import SkinPoints

__all__ = ["CAPSULES", "END", "LOWER", "SPHERES", "UPPER", "fit_limb"]

UPPER_STATIONS, LOWER_STATIONS = (0.2, 0.5, 0.8), (0.0, 0.25, 0.5, 0.75, 1.0)
"""Along the segments; the upper one's end is the lower one's beginning."""
UPPER, LOWER, END = slice(1, 3), slice(3, 8), slice(8, 13)
"""Spheres that are kept out of other parts. The first one is not, as it joins the limb to the trunk."""
SPHERES = 13
CAPSULES = ((0, 3), (3, 7), (7, 12))
"""Spheres that capsules span: upper segment, lower segment, hand or foot."""
BLUR = 0.08
"""Of a segment's length, about a station."""
FEWEST = 8
"""Skin points that a segment must have."""
FLAT = 1.5
"""Half of a hand's thickness over the standard deviation of its skin."""


def fit_limb(joints: np.ndarray, segments: SkinPoints, end: SkinPoints) -> tuple[np.ndarray, np.ndarray]:
    """Centres (13, 3) and radii (13,) of the spheres of a limb.

    joints: (3, 3) where the upper segment, the lower one and hand or foot begin. segments: skin of both segments. end:
    of hand or foot; where there is hardly any it is as thick as the wrist and a quarter as long as the lower segment.
    Raises ValueError where the segments have hardly any skin.
    """
    if len(segments.points) < FEWEST:
        raise ValueError(f"it has {len(segments.points)} skin points, at least {FEWEST} are needed")
    centres, radii = [], []
    for start, stop, stations in zip(joints, joints[1:], (UPPER_STATIONS, LOWER_STATIONS)):
        for station in stations:
            centre, radius = _fit_circle(segments, start, stop, station)
            centres.append(centre)
            radii.append(radius)
    if len(end.points) >= FEWEST:
        more_centres, more_radii = _fit_end(joints[2], end)
    else:
        along = joints[2] - joints[1]
        more_centres = joints[2] + np.outer([0.05, 0.05, 0.15, 0.15, 0.25], along)
        more_radii = np.full(5, radii[-1])
    return np.concatenate([centres, more_centres]), np.concatenate([radii, more_radii])


def _fit_circle(skin: SkinPoints, start: np.ndarray, stop: np.ndarray, station: float) -> tuple[np.ndarray, float]:
    """Centre and radius of the limb's cross section, by least squares of the circle's equation."""
    axis = stop - start
    length = max(float(np.linalg.norm(axis)), 1e-6)
    axis = axis / length
    offset = skin.points - (start + station * length * axis)
    apart = offset @ axis / length
    nearest = np.sort(np.abs(apart))[min(FEWEST, len(apart)) - 1]
    weight = skin.areas * np.exp(-0.5 * (apart / max(BLUR, nearest)) ** 2)
    side = np.linalg.svd(axis[None])[2][1:]
    flat = offset @ side.T
    across = np.linalg.norm(flat, axis=1)
    weight = weight * (across < 0.5 * length)  # not the other leg's
    weight = weight / max(weight.sum(), 1e-30)
    design = np.column_stack([flat, np.ones(len(flat))])
    normal = design.T @ (weight[:, None] * design) + 1e-9 * np.eye(3)
    half_x, half_y, constant = np.linalg.solve(normal, design.T @ (weight * across**2)) / 2
    typical = float(weight @ across)
    middle = np.array([half_x, half_y])
    middle *= min(1.0, typical / max(np.linalg.norm(middle), 1e-9))
    radius = float(weight @ np.linalg.norm(flat - middle, axis=1))
    return start + station * length * axis + middle @ side, radius


def _fit_end(joint: np.ndarray, skin: SkinPoints) -> tuple[np.ndarray, np.ndarray]:
    """Spheres of a hand or foot: two at a quarter of its length, two at 0.6 of it, one near the tip."""
    share = skin.areas / skin.areas.sum()
    middle = share @ skin.points
    _, axes = np.linalg.eigh((skin.points - middle).T @ (share[:, None] * (skin.points - middle)))
    thin, wide, along = axes.T
    along = along if along @ (middle - joint) > 0 else -along
    t, w, h = ((skin.points - middle) @ np.stack([along, wide, thin], axis=1)).T
    near, far = np.quantile(t, [0.01, 0.99])
    centres, radii = [], []
    for place, halves in ((0.25, (-1, 1)), (0.6, (-1, 1)), (0.9, (0,))):
        for half in halves:
            weight = share * np.exp(-0.5 * ((t - near - place * (far - near)) / (0.12 * (far - near))) ** 2)
            weight = weight * (half * (w - np.average(w, weights=weight)) >= 0)
            weight = weight / weight.sum()
            centre = weight @ skin.points
            thickness = np.sqrt(weight @ (h - weight @ h) ** 2)
            centres.append(centre)
            radii.append(FLAT * thickness)
    return np.array(centres), np.array(radii)
