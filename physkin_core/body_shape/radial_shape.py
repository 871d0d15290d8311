"""The trunk of a body as a smooth surface: a radius about a vertical axis, by height and direction.

Quadratic B-splines of height times a Fourier series of direction, fitted to the skin. Unlike capsules it follows
bellies, waists and hips, and its slope is continuous. Above and below it narrows as cones do.
Dimensions: `J` splines, `H` harmonics, `V` skin points. Metres, canonical pose, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["RadialShape", "fit_radial_shape"]

SPLINES, HARMONICS = 8, 4
SMOOTHING = 2e-3
"""Of coefficients' differences from height to height and of higher harmonics, against a mean square distance of 1."""
AXIS_BLUR = 0.02
"""[m] so near to the axis directions lose their meaning."""
CAP_SLOPES = (3.0, 1.0)
"""By how much the radius shrinks with the distance below and above."""
ROUNDING = 0.03
"""[m] within which of its ends the surface turns from one slope to the other."""


@dataclass(frozen=True)
class RadialShape:
    """centre: (2,) X and Y of the axis. low, high: heights between which it was fitted. coefficients: (J, 2 H + 1)
    [m], radius, then cosine and sine of each harmonic."""

    centre: np.ndarray
    low: float
    high: float
    coefficients: np.ndarray

    def depth(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points (V, 3) are inside, (V,), negative outside, to first order; normals (V, 3) outwards, of unit
        length except near the axis, where all directions out are alike."""
        x, y, z = (np.asarray(points, dtype=np.float64) - [*self.centre, 0.0]).T
        distance = np.sqrt(x**2 + y**2 + AXIS_BLUR**2)
        below, shrinks = _ramp(self.low - z)
        above, narrows = _ramp(z - self.high)
        spline, slope = _splines(z + below - above, self.low, self.high, len(self.coefficients))
        wave, turn = _waves(x / distance, y / distance, self.coefficients.shape[1] // 2)
        radius = np.einsum("vj,jh,vh->v", spline, self.coefficients, wave)
        by_height = np.einsum("vj,jh,vh->v", slope, self.coefficients, wave) * (1 - shrinks - narrows)
        by_angle = np.einsum("vj,jh,vh->v", spline, self.coefficients, turn)
        cap = CAP_SLOPES[0] * below + CAP_SLOPES[1] * above
        along = CAP_SLOPES[1] * narrows - CAP_SLOPES[0] * shrinks
        around = by_angle / distance**2
        gradient = np.stack([x / distance + around * y, y / distance - around * x, along - by_height], axis=1)
        steep = np.sqrt((gradient**2).sum(axis=1) + (AXIS_BLUR / distance) ** 2)
        return (radius - distance - cap) / steep, gradient / steep[:, None]


def fit_radial_shape(points: np.ndarray, areas: np.ndarray, low: float, high: float) -> RadialShape:
    """The smooth surface nearest to skin points (V, 3) that stand for areas (V,), least squares."""
    centre = np.average(points[:, :2], axis=0, weights=areas)
    x, y = (points[:, :2] - centre).T
    distance = np.sqrt(x**2 + y**2 + AXIS_BLUR**2)
    spline, _ = _splines(points[:, 2], low, high, SPLINES)
    wave, _ = _waves(x / distance, y / distance, HARMONICS)
    design = np.einsum("vj,vh->vjh", spline, wave).reshape(len(points), -1)
    weighted = design * (areas / areas.sum())[:, None]
    order = np.repeat(np.arange(HARMONICS + 1), [1, *[2] * HARMONICS])
    steps = np.diff(np.eye(SPLINES), axis=0)
    smooth = np.kron(steps.T @ steps, np.eye(len(order))) + np.kron(np.eye(SPLINES), np.diag(0.05 * order**2.0))
    found = np.linalg.solve(design.T @ weighted + SMOOTHING * smooth, weighted.T @ distance)
    return RadialShape(centre, low, high, found.reshape(SPLINES, -1))


def _splines(z: np.ndarray, low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Uniform quadratic B-splines (V, J) at heights z from `low` to `high`, and their slopes [1/m]."""
    scale = (count - 2) / (high - low)
    at = np.clip((z - low) * scale, 0.0, count - 2.0)
    cell = np.minimum(at.astype(int), count - 3)
    u = at - cell
    values, slopes = np.zeros((2, len(z), count))
    row = np.arange(len(z))
    for k, (value, slope) in enumerate(
        (((1 - u) ** 2 / 2, u - 1), (0.5 + u * (1 - u), 1 - 2 * u), (u**2 / 2, u)),
    ):
        values[row, cell + k], slopes[row, cell + k] = value, slope * scale
    return values, slopes


def _waves(cosine: np.ndarray, sine: np.ndarray, harmonics: int) -> tuple[np.ndarray, np.ndarray]:
    """Fourier terms (V, 2 H + 1) of a direction, and their derivatives by its angle."""
    values, turns = [np.ones_like(cosine)], [np.zeros_like(cosine)]
    c, s = np.ones_like(cosine), np.zeros_like(sine)
    for k in range(1, harmonics + 1):
        c, s = c * cosine - s * sine, s * cosine + c * sine
        values += [c, s]
        turns += [-k * s, k * c]
    return np.stack(values, axis=1), np.stack(turns, axis=1)


def _ramp(excess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is above zero, with a rounded corner; and its slope."""
    shifted = np.clip(excess + ROUNDING, 0.0, 2 * ROUNDING)
    return shifted**2 / (4 * ROUNDING) + np.maximum(excess - ROUNDING, 0.0), shifted / (2 * ROUNDING)
