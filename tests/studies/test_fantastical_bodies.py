"""Fantastical bodies: beyond the adults, without folds, on the same rig and mesh."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import load_body_model
from physkin_studies.fantastical_bodies import KINDS, Swelling, fantastical_body_model

ADULTS = load_body_model()


@pytest.fixture(scope="module")
def bodies():
    return fantastical_body_model()


def volume(model, coefficients):
    a, b, c = model.vertices(coefficients)[model.faces].transpose(1, 0, 2).astype(np.float64)
    return (a * np.cross(b, c)).sum() / 6


def heights(model, kinds=None):
    held_out = model.held_out_bodies if kinds is None else model.held_out_bodies[kinds]
    return np.array([np.ptp(model.vertices(body)[:, 2]) for body in held_out])


def test_kinds_take_turns_and_differ_as_named(bodies):
    """Children are smaller than every adult, giants larger than most; a child's head is the larger part of it."""
    step, names = len(KINDS), list(KINDS)
    adult = heights(ADULTS)
    children, giants = (slice(names.index(kind), None, step) for kind in ("child", "giant"))
    assert heights(bodies, children).max() < adult.min()
    assert heights(bodies, giants).mean() > adult.max()
    head = ADULTS.rig.bone_names.index("head")

    def head_share(model, chosen):
        vertices = np.stack([model.vertices(body) for body in model.held_out_bodies[chosen][:4]])
        own = model.influence_bones[np.arange(len(vertices[0])), model.influence_weights.argmax(axis=1)] == head
        return np.mean(np.ptp(vertices[:, own, 2], axis=1) / np.ptp(vertices[:, :, 2], axis=1))

    assert head_share(bodies, children) > 1.1 * head_share(ADULTS, slice(None))


def test_bodies_are_whole_and_stand_where_the_others_do(bodies):
    """Positive volume, finite, the root at the origin, one body a coefficient, the garment maker's body kept."""
    assert all(volume(bodies, body) > 0.005 for body in bodies.held_out_bodies[:8])
    for body in bodies.held_out_bodies[:8]:
        heads, tails = bodies.bones(body)
        assert np.isfinite(heads).all() and np.isfinite(tails).all()
        np.testing.assert_allclose(heads[0], ADULTS.rig.heads[0], atol=0.08)
    np.testing.assert_allclose(bodies.vertices(bodies.garment_body), ADULTS.vertices(ADULTS.garment_body), atol=1e-6)
    used = np.concatenate([bodies.train_bodies, bodies.held_out_bodies])
    assert (used.sum(axis=1) == 1).all() and used.sum(axis=0).max() == 1


def test_bones_stay_inside_what_swells():
    """A swelling moves near points outwards, far ones not at all, and keeps the order along every ray."""
    swelling = Swelling(np.zeros(3), 0.1, 0.7)
    radius = np.linspace(0, 1, 400)
    moved = swelling(radius[:, None] * [0.6, 0.0, 0.8])
    distance = np.linalg.norm(moved, axis=1)
    assert (np.diff(distance) > 0).all()
    np.testing.assert_allclose(distance[1] / radius[1], 1.7, rtol=1e-3)
    np.testing.assert_allclose(moved[-1], [0.6, 0.0, 0.8], atol=1e-12)
