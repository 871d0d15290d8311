"""Splats: what a deformation makes of an ellipsoid."""

import numpy as np
import pytest
from random_models import random_rotation
from scipy.spatial.transform import Rotation

from physkin_core import Splats
from physkin_core.points.splats import moved_splats

COUNT = 500


def random_splats(rng, count=COUNT):
    """Of any orientation, some flat, some long."""
    return Splats(
        rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), np.exp(rng.uniform(-9, -4, size=(count, 3)))
    )


def covariances(splats):
    spokes = splats.axes().astype(np.float64) * splats.scales[:, None]
    return spokes @ spokes.swapaxes(1, 2)


def moved(splats, linear):
    """By linear maps (n, 3, 3), centres left where they are."""
    return moved_splats(splats.centres, np.einsum("nij,njk->kni", linear, splats.axes()), splats.scales)


def turned_by(before, after):
    """(n,) angles [rad] between orientations."""
    return (Rotation.from_quat(after.rotations) * Rotation.from_quat(before.rotations).inv()).magnitude()


def test_covariance_is_that_of_the_affine_map():
    """Shear included, for maps that are far from rotations."""
    rng = np.random.default_rng(0)
    splats = random_splats(rng)
    linear = np.array([random_rotation(rng) for _ in range(COUNT)]) @ (np.eye(3) + 0.2 * rng.normal(size=(COUNT, 3, 3)))
    found, expected = covariances(moved(splats, linear)), linear @ covariances(splats) @ linear.swapaxes(1, 2)
    assert (np.abs(found - expected).max(axis=(1, 2)) / np.abs(expected).max(axis=(1, 2))).max() < 2e-5


def test_rigid_motion_turns_splats_exactly():
    """Axes are those they were, by name: of round splats, too."""
    rng = np.random.default_rng(1)
    splats = random_splats(rng)
    splats.scales[::2] = 0.004
    turn = np.array([random_rotation(rng) for _ in range(COUNT)])
    found = moved(splats, turn)
    np.testing.assert_allclose(found.scales, splats.scales, rtol=1e-5)
    expected = Splats(splats.centres, (Rotation.from_matrix(turn) * Rotation.from_quat(splats.rotations)).as_quat(),
                      splats.scales)  # fmt: skip
    flat = np.ptp(splats.scales, axis=1) > 1e-9
    assert turned_by(expected, found)[flat].max() < 1e-3  # rounding turns axes of nearly the same length
    np.testing.assert_allclose(covariances(found), covariances(expected), atol=1e-5 * splats.scales.max() ** 2)
    still = moved(splats, np.tile(np.eye(3), (COUNT, 1, 1)))
    np.testing.assert_allclose(still.scales, splats.scales, rtol=1e-5)


def test_stretch_along_an_axis_is_in_its_scale():
    rng = np.random.default_rng(2)
    splats = random_splats(rng)
    stretch = splats.axes() * np.array([1.3, 0.9, 1.0]) @ splats.axes().swapaxes(1, 2)
    found = moved(splats, stretch)
    np.testing.assert_allclose(found.scales, splats.scales * [1.3, 0.9, 1.0], rtol=1e-5)
    assert turned_by(splats, found).max() < 1e-3


def test_a_mirrored_splat_is_still_an_ellipsoid():
    splats = random_splats(np.random.default_rng(3))
    found = moved(splats, np.tile(np.diag([1.0, -1.0, 1.0]), (COUNT, 1, 1)))
    mirror = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(covariances(found), mirror @ covariances(splats) @ mirror, atol=1e-8)


def test_other_axes_and_units():
    rng = np.random.default_rng(4)
    splats, turn = random_splats(rng), random_rotation(rng)
    there = splats.transformed(0.01 * turn)
    np.testing.assert_allclose(covariances(there), 1e-4 * turn @ covariances(splats) @ turn.T, atol=1e-12)
    back = there.transformed(np.linalg.inv(0.01 * turn))
    np.testing.assert_allclose(back.centres, splats.centres, atol=1e-6)
    assert turned_by(splats, back).max() < 1e-3


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"centres": np.zeros(3)}, r"centres of splats must have shape \(3, 3\), got \(3,\)"),
        ({"rotations": np.ones((2, 4))}, r"rotations of splats must have shape \(5, 4\)"),
        ({"centres": np.full((5, 3), np.nan)}, "splat 0: its centres must be finite"),
        ({"scales": np.array([[1, 1, 1]] * 4 + [[1, 0, 1]])}, "splat 4: its scales must be positive"),
        ({"scales": np.full((5, 3), 1e60)}, "splat 0: its scales must be finite"),
        ({"rotations": np.eye(5, 4)}, "splat 4: its rotation must be a quaternion with a length"),
    ],
)
def test_bad_splats_are_refused(changed, message):
    given = {"centres": np.zeros((5, 3)), "rotations": np.ones((5, 4)), "scales": np.ones((5, 3))}
    with pytest.raises(ValueError, match=message):
        Splats(**{**given, **changed})
