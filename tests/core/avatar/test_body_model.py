"""Compact body model: what the shipped file holds, and that bodies are the mean plus coefficients times components."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from physkin_core import load_body_model

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
    gap = np.linalg.norm(BODY.held_out_bodies[:, None] - BODY.train_bodies, axis=-1)
    assert gap.min() > 0.1


@pytest.mark.parametrize("kind", ["train_bodies", "held_out_bodies", "garment_body"])
def test_bodies_are_adults_at_the_origin(kind):
    """Closed surfaces facing out, root at the origin, hands wide and feet down, of an adult's height."""
    heights = []
    for coefficients in np.atleast_2d(getattr(BODY, kind))[:12]:
        vertices = BODY.vertices(coefficients)
        heads, tails = BODY.bones(coefficients)
        body = trimesh.Trimesh(vertices, BODY.faces, process=False)
        assert body.is_watertight and body.volume > 0.02
        np.testing.assert_allclose(heads[0], 0, atol=1e-5)
        at = dict(zip(BODY.rig.bone_names, heads))
        assert at["wrist.L"][1] > 0.2 > -0.2 > at["wrist.R"][1], "left is +Y"
        assert at["foot.L"][2] < -0.5 < 0.2 < at["head"][2], "up is +Z"
        assert tails[BODY.rig.bone_index("foot.L")][0] > at["foot.L"][0], "toes point to +X"
        heights.append(np.ptp(vertices[:, 2]))
        assert np.linalg.norm(tails - heads, axis=1).min() > 1e-3
    assert 1.1 < min(heights) and max(heights) < 2.5


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
