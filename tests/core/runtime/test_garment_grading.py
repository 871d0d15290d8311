"""Grading: what a change of the body's surface becomes on the garment."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import tube

from physkin_core import Garment, load_body_model
from physkin_core.runtime.garment_grading import GarmentGrading

BODY = load_body_model()
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def grading():
    """A band about the waist, mirror symmetric, about 3 cm from the body."""
    band = tube(rings=9, segments=24, radius=1.0, height=0.3)
    return GarmentGrading(Garment(band.vertices * [0.17, 0.21, 1.0] + [0, 0, 0.12], band.faces), BODY)


def test_the_garment_makers_body_wears_the_template(grading):
    np.testing.assert_allclose(grading.graded(BODY.garment_body[None])[0], grading.garment.vertices, atol=1e-9)


def test_a_body_that_moves_takes_the_garment_along(grading):
    """A shift of all of the body shifts the garment by just as much."""
    shift = np.tile([0.1, -0.2, 0.3], (len(BODY.mean_vertices), 1))
    np.testing.assert_allclose(grading.carried(shift), np.tile([0.1, -0.2, 0.3], (9 * 24, 1)), atol=1e-9)


def test_grading_is_linear_and_the_same_by_coefficients(grading):
    """Displacements one by one or together, and a body by its coefficients or by its surface."""
    fields = 0.1 * RNG.normal(size=(2, len(BODY.mean_vertices), 3))
    first, second = grading.carried(fields)
    np.testing.assert_allclose(grading.carried(fields[1]), second, atol=1e-12)
    np.testing.assert_allclose(grading.carried(2 * fields[0] - fields[1]), 2 * first - second, atol=1e-10)
    bodies = BODY.held_out_bodies[:2]
    for coefficients, graded in zip(bodies, grading.graded(bodies), strict=True):
        moved = BODY.vertices(coefficients).astype(np.float64) - BODY.vertices(BODY.garment_body)
        np.testing.assert_allclose(graded, grading.garment.vertices + grading.carried(moved), atol=1e-6)


def test_a_wider_body_gets_a_wider_garment_of_the_same_height(grading):
    """The trunk 10 % wider: so is the band, and it is as high as before."""
    maker = BODY.vertices(BODY.garment_body).astype(np.float64)
    graded = grading.garment.vertices + grading.carried(maker * [0.1, 0.1, 0.0])
    size, before = np.ptp(graded, axis=0), np.ptp(grading.garment.vertices, axis=0)
    np.testing.assert_allclose(size - before, 0.1 * before * [1, 1, 0], atol=0.012)
    assert (size - before)[:2].min() > 0.015


def test_nodes_are_graded_as_the_vertex_they_lie_on(grading):
    chosen = [3, 200, 77]
    np.testing.assert_array_equal(grading.closest_vertices(grading.garment.vertices[chosen] + 1e-4), chosen)
