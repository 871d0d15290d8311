"""Curvature of cloth from a few of its points: of a tube, wherever it is, and of one that is fluted."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import tube
from scipy.spatial.transform import Rotation

from physkin_core.model.garment import Garment
from physkin_training.dynamics.fold_curvature import FoldCurvature

RADIUS = 0.2


@pytest.fixture(scope="module")
def skirt():
    band = tube(rings=13, segments=40, radius=1.0, height=0.36)
    return Garment(band.vertices * [RADIUS, RADIUS, 1.0], band.faces)


def test_a_tube_wherever_it_is(skirt):
    every = np.arange(len(skirt.vertices))
    turned = skirt.vertices @ Rotation.from_rotvec([1.0, 2.0, 3.0]).as_matrix().T + [1, 2, 3]
    found = FoldCurvature(skirt, every)(np.stack([skirt.vertices, turned]))
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
    inner = np.abs(skirt.vertices[:, 2] - skirt.vertices[:, 2].mean()) < 0.1
    assert np.abs(found[0][inner]) == pytest.approx(0.5 / RADIUS, rel=0.2)
    assert len(set(np.sign(found[0][inner]))) == 1


def test_flutes_bend_in_and_out(skirt):
    """Eight flutes, 2 cm deep: both ways, and far more than a round tube does."""
    around = np.arctan2(skirt.vertices[:, 1], skirt.vertices[:, 0])
    fluted = skirt.vertices * (1 + 0.1 * np.cos(8 * around))[:, None] ** [1, 1, 0]
    found = FoldCurvature(skirt, np.arange(len(around)))(np.stack([skirt.vertices, fluted]))
    round_tube, flutes = found
    assert np.ptp(flutes) > 5 * np.ptp(round_tube)
    assert (flutes > 0).any() and (flutes < 0).any() and len(set(np.sign(round_tube))) == 1


def test_too_few_points(skirt):
    with pytest.raises(ValueError, match="at least 7 points, got 6"):
        FoldCurvature(skirt, np.arange(6))
