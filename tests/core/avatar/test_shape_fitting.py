"""The body model laid on avatars of its own kind with another triangulation, against exact correspondence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from physkin_core import avatar_from_body, load_body_model, load_garment
from physkin_core.avatar.shape_fitting import fit_shape, surface_on_avatar
from physkin_core.runtime.garment_grading import GarmentGrading

BODY = load_body_model()
GARMENTS = Path(__file__).parents[3] / "training" / "garments"


def remeshed(avatar, seed):
    """The same surface with a quarter of its faces cut into four, in another order."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(avatar.faces), len(avatar.faces) // 4, replace=False)
    vertices, faces = trimesh.remesh.subdivide(avatar.vertices, avatar.faces, face_index=chosen)
    order = rng.permutation(len(vertices))
    place = np.argsort(order)
    faces = place[rng.permutation(faces)].astype(np.int32)
    return replace(avatar, vertices=vertices[order].astype(np.float32), faces=faces)


@pytest.mark.parametrize("body", [0, 12, 60])
def test_the_graded_garment_is_that_of_exact_correspondence(body):
    """Within 5 mm at every vertex of the dress and 2 mm on average, where bodies differ by centimetres."""
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[body])
    grading = GarmentGrading(load_garment(GARMENTS / "dress.obj"), BODY)
    exact = grading.carried(avatar.vertices - grading.template)
    found = grading.carried(surface_on_avatar(remeshed(avatar, body), BODY) - grading.template)
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
    missing = (vertices - BODY.vertices(fit_shape(swollen, BODY)))[there, 0].mean()
    left = (vertices - surface_on_avatar(swollen, BODY))[there, 0].mean()
    assert missing > 0.01
    assert abs(left) < 0.4 * missing
