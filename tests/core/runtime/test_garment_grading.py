"""Grading: what a change of the body's surface becomes on the garment."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import tube

from physkin_core import Garment, load_body_model
from physkin_core.runtime.garment_grading import GarmentGrading
from physkin_training.contact.surface_queries import BodySurface

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


def test_what_is_carried_is_linear(grading):
    first, second = 0.1 * RNG.normal(size=(2, len(BODY.mean_vertices), 3))
    expected = 2 * grading.carried(first) - grading.carried(second)
    np.testing.assert_allclose(grading.carried(2 * first - second), expected, atol=1e-10)


def test_a_body_is_the_same_by_its_coefficients_or_by_its_surface(grading):
    coefficients = BODY.held_out_bodies[0]
    expected = grading.garment.vertices + grading.measured(BODY.vertices(coefficients).astype(np.float64))
    np.testing.assert_allclose(grading.graded(coefficients[None])[0], expected, atol=1e-9)


def test_a_wider_body_gets_a_wider_garment_of_the_same_height(grading):
    """The trunk 10 % wider: so is the band, and it is as high as before."""
    graded = grading.garment.vertices + grading.measured(grading.template * [1.1, 1.1, 1.0])
    size, before = np.ptp(graded, axis=0), np.ptp(grading.garment.vertices, axis=0)
    np.testing.assert_allclose(size - before, 0.1 * before * [1, 1, 0], atol=0.012)
    assert (size - before)[:2].min() > 0.015


def test_cloth_bridges_dents_and_is_let_out_over_bumps(grading):
    """Of a belly 6 cm out or in: cloth clears the one, and goes less than half of the way into the other."""
    ahead = (np.linalg.norm(grading.template - [0.1, 0, 0.12], axis=1) < 0.1) & (grading.template[:, 0] > 0)
    belly = 0.06 * ahead[:, None] * np.array([1.0, 0.0, 0.0])
    let_out, drawn_in = grading.measured(grading.template + belly), grading.measured(grading.template - belly)
    surface = BodySurface(grading.template + belly, BODY.faces)
    assert surface.closest(grading.garment.vertices + let_out).distance.min() > 0.002
    assert 0.03 < let_out[:, 0].max() < 0.06
    assert np.abs(drawn_in).max() < 0.03
    behind = grading.garment.vertices[:, 0] < -0.05
    assert np.abs(let_out[behind]).max() < 0.005


def test_a_childs_garment_is_the_adults_at_its_scale(grading):
    """Of an adult's shape 1.05 m tall, to the last bit; of one of usual size nothing is scaled."""
    small = 1.05 / np.ptp(grading.template[:, 2])
    graded = grading.garment.vertices + grading.measured(small * grading.template)
    np.testing.assert_allclose(graded, small * grading.garment.vertices, atol=1e-9)
    (child,) = grading.graded(BODY.held_out_children[BODY.statures(BODY.held_out_children).argmin()][None])
    away = BodySurface(grading.template, BODY.faces).closest(grading.garment.vertices).distance
    shape = BODY.vertices(BODY.held_out_children[BODY.statures(BODY.held_out_children).argmin()])
    nearer = BodySurface(shape.astype(np.float64), BODY.faces).closest(child).distance
    assert np.median(nearer) < 0.75 * np.median(away)


def test_garments_change_gradually_with_stature(grading):
    """A centimetre of stature changes no point by more than two, from children to adults."""
    sizes = np.arange(1.0, 1.7, 0.01) / np.ptp(grading.template[:, 2])
    graded = grading.measured(sizes[:, None, None] * grading.template)
    assert np.linalg.norm(np.diff(graded, axis=0), axis=-1).max() < 0.02


def test_nodes_are_graded_as_the_vertex_they_lie_on(grading):
    chosen = [3, 200, 77]
    np.testing.assert_array_equal(grading.closest_vertices(grading.garment.vertices[chosen] + 1e-4), chosen)
