"""The body model laid on avatars of its own kind with another triangulation, against exact correspondence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from odd_avatars import remeshed, with_odd_pivots

from physkin_core import avatar_from_body, load_body_model, load_garment
from physkin_core.avatar.shape_fitting import lay_body
from physkin_core.runtime.garment_grading import GarmentGrading

BODY = load_body_model()
GARMENTS = Path(__file__).parents[3] / "training" / "garments"


@pytest.mark.parametrize("body", [12, *(pytest.param(body, marks=pytest.mark.slow) for body in (0, 60))])
def test_the_graded_garment_is_that_of_exact_correspondence(body):
    """Within 5 mm at every vertex of the dress and 2 mm on average, where bodies differ by centimetres."""
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[body])
    grading = GarmentGrading(load_garment(GARMENTS / "dress.obj"), BODY)
    exact = grading.carried(avatar.vertices - grading.template)
    found = grading.carried(lay_body(remeshed(avatar, body), BODY).surface - grading.template)
    error = np.linalg.norm(found - exact, axis=1)
    assert error.max() < 5e-3 and error.mean() < 2e-3
    assert np.linalg.norm(exact, axis=1).max() > 0.02


def test_what_the_body_model_cannot_take_on_is_added():
    """A belly no coefficients have: 5 cm out at the front. The fitted body lacks it, the laid-on surface has it."""
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[12])
    x, y, z = avatar.vertices.T
    bump = np.where(x > 0, 0.05 * np.exp(-(((z - 0.1) / 0.07) ** 2) - (y / 0.07) ** 2), 0)
    vertices = avatar.vertices + bump[:, None] * np.array([1.0, 0, 0], dtype=np.float32)
    swollen = replace(avatar, vertices=vertices.astype(np.float32))
    there = bump > 0.04
    laid = lay_body(remeshed(swollen, 1), BODY)
    missing = (vertices - (laid.surface - laid.missing))[there, 0].mean()
    left = (vertices - laid.surface)[there, 0].mean()
    assert missing > 0.01
    assert abs(left) < 0.4 * missing


def test_a_body_with_the_body_models_own_faces_is_found_exactly():
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[7])
    laid = lay_body(avatar, BODY)
    np.testing.assert_allclose(laid.coefficients, BODY.held_out_bodies[7], atol=1e-2)
    np.testing.assert_allclose(laid.surface, avatar.vertices, atol=1e-6)
    assert np.linalg.norm(laid.missing, axis=1).max() < 1e-4 and np.linalg.norm(laid.place) < 1e-4


@pytest.mark.parametrize("body", [3, pytest.param(11, marks=pytest.mark.slow)])
def test_pivots_elsewhere_in_the_flesh_do_not_move_the_surface(body):
    """Bones 2 to 6 cm astray, and the body is that of its skin, to half a millimetre on average."""
    avatar = remeshed(avatar_from_body(BODY, BODY.held_out_bodies[body]), body)
    right, odd = lay_body(avatar, BODY), lay_body(with_odd_pivots(avatar, body), BODY)
    assert np.linalg.norm(odd.surface - right.surface, axis=1).mean() < 5e-4
    assert np.linalg.norm(odd.place - right.place) < 1e-3


def test_unlikely_bodies_are_those_that_training_saw_and_a_rest():
    """Twice the most unusual training body: coefficients stay within what networks know, the rest is a displacement."""
    furthest = BODY.train_bodies[np.linalg.norm(BODY.train_bodies, axis=1).argmax()]
    avatar = avatar_from_body(BODY, 2 * furthest)
    laid = lay_body(avatar, BODY)
    assert np.linalg.norm(laid.coefficients) <= np.linalg.norm(furthest) + 1e-6
    np.testing.assert_allclose(laid.surface, avatar.vertices, atol=1e-6)
