"""Gaussian splats, and how a deformation moves them.

A splat is an ellipsoid: a centre, axes, and a standard deviation along each. A deformation that is affine over a splat,
J, makes an ellipsoid of it again, and that is the one here, with shear: its covariance is J C J^T.
Dimensions: `n` splats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Splats", "moved_splats"]

SWEEPS = 3
"""Of three rotations each; axes are then perpendicular to some 1e-5 for stretches such as cloth has."""
TINY = np.float32(1e-30)


@dataclass(frozen=True)
class Splats:
    """Gaussian splats, as float32 arrays.

    Args:
        centres: (n, 3) [m].
        rotations: (n, 4) quaternions x, y, z, w, from a splat's axes to the frame of the centres. They are normalised.
        scales: (n, 3) [m] standard deviations along the axes.

    Raises:
        ValueError: for wrong shapes, values that are not finite, quaternions of no length, and scales that are not
            positive.

    Examples:
        >>> physkin.Splats([[0, 0, 1]], [[0, 0, 0, 1]], [[0.01, 0.01, 0.001]]).covariances().shape
        (1, 3, 3)
    """

    centres: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.centres))
        for name, width in (("centres", 3), ("rotations", 4), ("scales", 3)):
            with np.errstate(over="ignore"):
                array = np.array(getattr(self, name), dtype=np.float32)
            if array.shape != (count, width):
                raise ValueError(f"{name} of splats must have shape ({count}, {width}), got {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"splat {_first(~np.isfinite(array))}: its {name} must be finite")
            object.__setattr__(self, name, array)
        if (flat := self.scales <= 0).any():
            raise ValueError(f"splat {_first(flat)}: its scales must be positive, got {self.scales[_first(flat)]}")
        length = np.linalg.norm(self.rotations, axis=1, keepdims=True)
        if (none := length < 1e-9).any():
            raise ValueError(f"splat {_first(none)}: its rotation must be a quaternion with a length, got zero")
        object.__setattr__(self, "rotations", self.rotations / length)

    def axes(self) -> np.ndarray:
        """(n, 3, 3) float32, the unit axes of the splats as columns."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.rotations).as_matrix().astype(np.float32)

    def covariances(self) -> np.ndarray:
        """(n, 3, 3) float32 [m2]."""
        columns = self.axes() * self.scales[:, None]
        return columns @ columns.transpose(0, 2, 1)

    def transformed(self, linear: np.ndarray) -> Splats:
        """The splats in another frame and unit.

        Args:
            linear: (3, 3), a rotation times a scale.

        Returns:
            New splats.
        """
        from scipy.spatial.transform import Rotation

        scale = np.cbrt(np.linalg.det(linear))
        rotations = (Rotation.from_matrix(linear / scale) * Rotation.from_quat(self.rotations)).as_quat()
        return Splats(self.centres @ linear.T, rotations, self.scales * scale)


def moved_splats(centres: np.ndarray, steps: np.ndarray, scales: np.ndarray) -> Splats:
    """Splats after a deformation that is known by where it takes each splat's axes.

    centres: (n, 3) [m] moved. steps: (3, n, 3) what became of each splat's first, second and third unit axis. scales:
    (n, 3) [m] before. Each axis is named as the one that it came from, by the smallest turns that make them
    perpendicular again.
    """
    columns = np.ascontiguousarray(steps.transpose(0, 2, 1), dtype=np.float32)  # axis, coordinate, splat
    columns *= scales.T[:, None]
    for _ in range(SWEEPS):
        for one, other in ((0, 1), (0, 2), (1, 2)):
            _make_perpendicular(columns[one], columns[other])
    lengths = np.maximum(np.sqrt(np.einsum("acn,acn->an", columns, columns)), TINY)
    axes = columns / lengths[:, None]
    axes[2] = np.cross(axes[0], axes[1], axis=0)  # right-handed, too, where the deformation mirrors
    return Splats(centres, _quaternions(axes), lengths.T)


def _make_perpendicular(one: np.ndarray, other: np.ndarray) -> None:
    """Mix two columns (3, n) in place by a rotation, the smaller of those that make them perpendicular (a step of the
    one-sided Jacobi method). The sum of their outer products stays what it is."""
    difference = np.einsum("cn,cn->n", other, other) - np.einsum("cn,cn->n", one, one)
    twice = 2 * np.einsum("cn,cn->n", one, other)
    tangent = twice / (np.abs(difference) + np.sqrt(difference * difference + twice * twice) + TINY)
    tangent = np.copysign(tangent, twice * np.where(difference < 0, -1, 1))
    cosine = 1 / np.sqrt(1 + tangent * tangent)
    sine = cosine * tangent
    mixed = cosine * one - sine * other
    other *= cosine
    other += sine * one
    one[:] = mixed


def _quaternions(axes: np.ndarray) -> np.ndarray:
    """(n, 4) x, y, z, w of any length, of frames (axis, coordinate, n) that are perpendicular in single precision;
    SciPy would take each through a singular value decomposition."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = axes
    products = np.array(  # of a quaternion's numbers with each other, times 4
        [
            [1 + xx - yy - zz, xy + yx, xz + zx, yz - zy],
            [xy + yx, 1 - xx + yy - zz, yz + zy, zx - xz],
            [xz + zx, yz + zy, 1 - xx - yy + zz, xy - yx],
            [yz - zy, zx - xz, xy - yx, 1 + xx + yy + zz],
        ]
    )
    largest = np.einsum("qqn->qn", products).argmax(axis=0)
    return products[largest, :, np.arange(len(largest))]


def _first(bad: np.ndarray) -> int:
    """Index of the first row (n, k) with a True."""
    return int(bad.any(axis=1).argmax())
