"""Compact body model: what the shipped file holds, and that bodies are the mean plus coefficients times components."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from physkin_core import load_body_model
from physkin_core.avatar.body_model import ADULT_STATURE

BODY = load_body_model()


def test_bodies_are_linear_in_their_coefficients():
    """Coefficient by coefficient, vertex by vertex."""
    rng = np.random.default_rng(0)
    shape = rng.normal(size=len(BODY.vertex_components))
    vertices, (heads, tails) = BODY.vertices(shape), BODY.bones(shape)
    for index in rng.integers(0, len(vertices), size=20):
        expected = BODY.mean_vertices[index] + sum(c * v for c, v in zip(shape, BODY.vertex_components[:, index]))
        np.testing.assert_allclose(vertices[index], expected, atol=1e-6)
    for bone in range(BODY.rig.bone_count):
        expected = BODY.mean_bones[bone] + sum(c * v for c, v in zip(shape, BODY.bone_components[:, bone]))
        np.testing.assert_allclose([heads[bone], tails[bone]], expected, atol=1e-6)
    np.testing.assert_array_equal(BODY.vertices(np.zeros(len(shape))), BODY.mean_vertices)


def test_enough_different_bodies_to_train_and_to_test_on():
    """At least 100 training bodies and 16 held out, and no body in both."""
    assert len(BODY.train_bodies) >= 100 and len(BODY.held_out_bodies) >= 16
    assert len(BODY.held_out_children) >= 10 and len(BODY.held_out_elders) >= 10
    held_out = np.concatenate([BODY.held_out_bodies, BODY.held_out_children, BODY.held_out_elders])
    gap = np.linalg.norm(held_out[:, None] - BODY.train_bodies, axis=-1)
    assert gap.min() > 0.1


def test_statures_are_those_of_the_surface():
    statures = BODY.statures(BODY.held_out_children)
    for stature, coefficients in zip(statures, BODY.held_out_children):
        assert stature == pytest.approx(np.ptp(BODY.vertices(coefficients)[:, 2]), abs=1e-5)


@pytest.mark.parametrize("first", [64, 128, 512, 768])
def test_training_bodies_are_mixed_from_the_first_on(first):
    """Of any number of them about an eighth are smaller than adults, as are children of up to eleven; so are none of
    the held-out adults and elders, and half of the children."""
    small = BODY.statures(BODY.train_bodies[:first]) < ADULT_STATURE
    assert 0.08 < small.mean() < 0.2
    assert (BODY.statures(BODY.held_out_bodies) > ADULT_STATURE).all()
    assert (BODY.statures(BODY.held_out_elders) > ADULT_STATURE).all()
    assert 0.3 < (BODY.statures(BODY.held_out_children) < ADULT_STATURE).mean() < 0.8


def test_an_adult_of_any_size_is_a_body():
    """Twice as small: as exactly as half precision keeps it."""
    adult = BODY.vertices(BODY.held_out_bodies[3]).astype(np.float64)
    design = BODY.vertex_components.reshape(len(BODY.garment_body), -1).T.astype(np.float64)
    coefficients = np.linalg.lstsq(design, (adult / 2 - BODY.mean_vertices).ravel(), rcond=None)[0]
    assert np.abs(BODY.vertices(coefficients) - adult / 2).max() < 2e-4


@pytest.mark.parametrize(
    "kind, shortest, tallest",
    [
        ("train_bodies", 0.85, 2.2),
        ("garment_body", 1.6, 1.8),
        ("held_out_bodies", 1.4, 2.2),
        ("held_out_children", 0.85, 2.0),
        ("held_out_elders", 1.4, 2.2),
    ],
)
def test_bodies_are_people_at_the_origin(kind, shortest, tallest):
    """Closed surfaces facing out, root at the origin, hands wide and feet down, as tall as people are."""
    heights = []
    for coefficients in np.atleast_2d(getattr(BODY, kind))[:12]:
        vertices = BODY.vertices(coefficients)
        heads, tails = BODY.bones(coefficients)
        body = trimesh.Trimesh(vertices, BODY.faces, process=False)
        assert body.is_watertight and body.volume > 0.008
        np.testing.assert_allclose(heads[0], 0, atol=1e-5)
        at = dict(zip(BODY.rig.bone_names, heads))
        stature = np.ptp(vertices[:, 2])
        assert at["wrist.L"][1] > 0.12 * stature and at["wrist.R"][1] < -0.12 * stature, "left is +Y"
        assert at["foot.L"][2] < -0.3 * stature and at["head"][2] > 0.12 * stature, "up is +Z"
        assert tails[BODY.rig.bone_index("foot.L")][0] > at["foot.L"][0], "toes point to +X"
        heights.append(stature)
        assert np.linalg.norm(tails - heads, axis=1).min() > 1e-3
    assert shortest < min(heights) and max(heights) < tallest


def test_the_rig_is_that_of_the_garment_makers_body():
    heads, tails = BODY.bones(BODY.garment_body)
    np.testing.assert_allclose(heads, BODY.rig.heads, atol=1e-3)
    np.testing.assert_allclose(tails, BODY.rig.tails, atol=1e-3)


def test_weights_follow_the_bones():
    """Most of a vertex's influence lies with bones near it: weights in the right order, in the right frame."""
    vertices = BODY.vertices(BODY.garment_body)
    strongest = np.take_along_axis(BODY.influence_bones, BODY.influence_weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    middle = (BODY.rig.heads + BODY.rig.tails)[strongest] / 2
    length = np.linalg.norm(BODY.rig.tails - BODY.rig.heads, axis=1)[strongest]
    distance = np.linalg.norm(vertices - middle, axis=1)
    assert np.median(distance) < 0.15 and (distance < length + 0.25).all()
