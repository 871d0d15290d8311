"""Which cloth goes round both legs: from the garment's mesh and the bones that it follows, not from its name."""

import numpy as np
import pytest
from random_models import random_rig

import physkin_core as physkin
from physkin_core.model.garment import Garment
from physkin_core.runtime.around_legs import goes_round_both_legs, reaches_knees


@pytest.fixture(scope="module")
def rig():
    return physkin.load_garment_model("skirt").rig


def tube(middle, radius, top, bottom, *, segments=24, rings=8, open_by=0.0):
    angle = np.linspace(0, 2 * np.pi * (1 - open_by), segments, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius + middle
    heights = np.linspace(top, bottom, rings)
    vertices = np.concatenate([np.c_[ring, np.full(segments, z)] for z in heights])
    quads = [
        (
            r * segments + k,
            r * segments + (k + 1) % segments,
            (r + 1) * segments + k,
            (r + 1) * segments + (k + 1) % segments,
        )
        for r in range(rings - 1)
        for k in range(segments if not open_by else segments - 1)
    ]
    faces = [face for a, b, c, d in quads for face in ((a, c, b), (b, c, d))]
    return vertices.astype(np.float32), np.array(faces, dtype=np.int32)


def goes_round(rig, pieces, bone="upperleg02.L"):
    """Of a garment of these pieces, with a garment node at each vertex."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    vertices = np.concatenate([vertices for vertices, _ in pieces])
    faces = np.concatenate([faces + start for (_, faces), start in zip(pieces, starts)])
    bones = np.full(len(vertices), rig.bone_names.index(bone), dtype=np.int32)
    return goes_round_both_legs(Garment(vertices, faces), rig, vertices, bones)


def test_a_skirt_and_an_open_coat_do_and_legs_of_trousers_do_not(rig):
    assert goes_round(rig, [tube((0, 0), 0.25, 0.1, -0.45)])
    assert goes_round(rig, [tube((0, 0), 0.25, 0.1, -0.45, open_by=0.1)])
    assert not goes_round(rig, [tube((0, y), 0.08, -0.02, -0.8) for y in (0.1, -0.1)])


def test_what_does_not_reach_below_the_hips_or_has_none_does_not(rig):
    assert not goes_round(rig, [tube((0, 0), 0.25, 0.4, 0.05)])
    legless = random_rig(np.random.default_rng(0))
    vertices, faces = tube((0, 0), 0.25, 0.1, -0.45)
    bones = np.zeros(len(vertices), dtype=np.int32)
    assert not goes_round_both_legs(Garment(vertices, faces), legless, vertices, bones)


def test_a_sleeve_that_hangs_as_low_does_not(rig):
    assert not goes_round(rig, [tube((0, 0), 0.25, 0.1, -0.45)], bone="lowerarm01.L")


@pytest.mark.parametrize(("name", "does"), [("skirt", True), ("dress", True), ("trousers", False), ("tshirt", True)])
def test_of_shipped_garments(name, does):
    """A T-shirt does at its hem."""
    model = physkin.load_garment_model(name)
    assert goes_round_both_legs(model.garment, model.rig, model.node_rest, model.node_bone) == does


@pytest.mark.parametrize(
    ("shipped", "reaches"), [("tshirt", False), ("shorts", True), ("trousers", True), ("dress", True)]
)
def test_what_reaches_the_knees(shipped, reaches):
    model = physkin.load_garment_model(shipped)
    assert reaches_knees(model.rig, model.node_bone) == reaches
