"""Which garment nodes twist: from the garment's mesh and the bones that they follow, not from its name."""

import numpy as np
import pytest
from random_models import random_rig
from reference.node_twist import twisted

import physkin_core as physkin
from physkin_core.model.garment import Garment
from physkin_core.sway.node_twist import node_twist


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


def shares_of(rig, pieces, bone="upperleg02.L"):
    """Of garment nodes at all vertices of a garment of these pieces."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    vertices = np.concatenate([vertices for vertices, _ in pieces])
    faces = np.concatenate([faces + start for (_, faces), start in zip(pieces, starts)])
    bones = np.full(len(vertices), rig.bone_names.index(bone), dtype=np.int32)
    return vertices, node_twist(Garment(vertices, faces), rig, vertices, bones)


def test_cloth_round_both_legs_twists_the_more_the_lower(rig):
    vertices, shares = shares_of(rig, [tube((0, 0), 0.25, 0.1, -0.45)])
    assert (shares[vertices[:, 2] > 0] == 0).all()
    order = np.argsort(-vertices[:, 2])
    assert (np.diff(shares[order]) >= -1e-6).all() and shares.max() == 1
    assert 0.2 < shares[np.abs(vertices[:, 2] + 0.135).argmin()] < 0.6


def test_an_open_coat_twists_and_legs_of_trousers_do_not(rig):
    _, coat = shares_of(rig, [tube((0, 0), 0.25, 0.1, -0.45, open_by=0.1)])
    assert coat.max() == 1
    _, trousers = shares_of(rig, [tube((0, y), 0.08, -0.02, -0.8) for y in (0.1, -0.1)])
    assert len(trousers) == 0


def test_what_does_not_reach_below_the_hips_or_has_none_does_not_twist(rig):
    _, top = shares_of(rig, [tube((0, 0), 0.25, 0.4, 0.05)])
    assert len(top) == 0
    legless = random_rig(np.random.default_rng(0))
    vertices, faces = tube((0, 0), 0.25, 0.1, -0.45)
    assert len(node_twist(Garment(vertices, faces), legless, vertices, np.zeros(len(vertices), dtype=np.int32))) == 0


def test_a_sleeve_that_hangs_as_low_does_not_twist(rig):
    _, shares = shares_of(rig, [tube((0, 0), 0.25, 0.1, -0.45)], bone="lowerarm01.L")
    assert len(shares) == 0


@pytest.mark.parametrize(("name", "twists"), [("skirt", True), ("dress", True), ("trousers", False)])
def test_of_shipped_garments(name, twists):
    model = physkin.load_garment_model(name)
    shares = node_twist(model.garment, model.rig, model.node_rest, model.node_bone)
    assert (shares.max(initial=0) == 1) == twists
    assert twists or len(shares) == 0


def test_shirts_twist_a_little_at_the_hem():
    for name in ("tshirt", "longsleeve"):
        model = physkin.load_garment_model(name)
        assert 0 < node_twist(model.garment, model.rig, model.node_rest, model.node_bone).max() < 0.4


def test_on_raised_legs_cloth_lies_and_twists_the_less():
    nodes = np.concatenate([np.eye(3), [[0.2], [0], [-0.4]]], axis=1)[None].repeat(2, axis=0)
    shares, bone = np.array([1.0, 0.5]), np.array([0, 1])
    standing = np.tile(np.eye(3, 4), (2, 1, 1))
    sitting = standing.copy()
    sitting[:, :3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
    full = twisted(nodes, standing, shares, bone, 0.5)
    assert full[0, :2, 3] == pytest.approx([0.2 * np.cos(0.5), 0.2 * np.sin(0.5)])
    assert full[1, :2, 3] == pytest.approx([0.2 * np.cos(0.25), 0.2 * np.sin(0.25)])
    assert full[0, 2, 3] > full[1, 2, 3] > -0.4
    assert twisted(nodes, sitting, shares, bone, 0.5) == pytest.approx(nodes)


def test_one_raised_thigh_holds_the_cloth():
    """It would be turned through the thigh; a shin that swings back does not hold it."""
    nodes = np.concatenate([np.eye(3), [[0.2], [0], [-0.4]]], axis=1)[None].repeat(3, axis=0)
    shares, bone = np.array([0.5, 0.5, 1.0]), np.array([0, 1, 2])  # by either thigh, by a shin
    horizontal = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
    for raised, holds in ((0, True), (1, True), (2, False)):
        bones = np.tile(np.eye(3, 4), (3, 1, 1))
        bones[raised, :3, :3] = horizontal
        assert np.allclose(twisted(nodes, bones, shares, bone, 0.5), nodes) == holds
