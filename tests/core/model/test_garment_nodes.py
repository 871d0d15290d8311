"""Garment nodes: closest bones, other bodies, posing, correctives and composition, one node at a time."""

from __future__ import annotations

import numpy as np
from random_models import random_rig, random_rotation

from physkin_core.model.garment_nodes import (
    closest_bones,
    node_positions_on_body,
    pose_nodes,
)


def homogeneous(transform):
    return np.vstack([transform, [0, 0, 0, 1]])


def random_transforms(rng, *shape):
    flat = [np.c_[random_rotation(rng), rng.normal(size=3)] for _ in range(int(np.prod(shape)))]
    return np.array(flat).reshape(*shape, 3, 4)


def test_closest_bones_against_densely_sampled_segments():
    rng = np.random.default_rng(0)
    heads, tails = rng.uniform(-1, 1, size=(2, 12, 3))
    tails[3] = heads[3]  # a bone without length is a point
    points = rng.uniform(-1.2, 1.2, size=(300, 3))
    along = np.linspace(0, 1, 2001)[:, None]
    distances = np.stack(
        [
            np.linalg.norm(points[:, None] - (head + along * (tail - head)), axis=-1).min(axis=1)
            for head, tail in zip(heads, tails)
        ],
        axis=1,
    )
    chosen = closest_bones(points, heads, tails)
    assert chosen.dtype == np.int32 and len(np.unique(chosen)) > 8
    np.testing.assert_allclose(distances[np.arange(300), chosen], distances.min(axis=1), atol=1e-3)


def test_nodes_on_another_body_scale_with_their_bone():
    """Offset from the bone's head times the ratio of bone lengths; heads move with the body."""
    rng = np.random.default_rng(1)
    rig, ratio = random_rig(rng, bones=6), rng.uniform(0.5, 2, size=6)
    rest, bone = rng.normal(size=(9, 3)), rng.integers(0, 6, size=9)
    heads = rng.normal(size=(6, 3))
    tails = heads + ratio[:, None] * (rig.tails - rig.heads) @ random_rotation(rng)
    carried = node_positions_on_body(rest, bone, (rig.heads, rig.tails), (heads, tails))
    for node in range(9):
        k = bone[node]
        np.testing.assert_allclose(carried[node], heads[k] + ratio[k] * (rest[node] - rig.heads[k]), atol=1e-12)
    same = node_positions_on_body(rest, bone, (rig.heads, rig.tails), (rig.heads, rig.tails))
    np.testing.assert_allclose(same, rest, atol=1e-12)


def test_posed_nodes_ride_on_their_bones():
    """A matrix product a node, on any number of leading axes."""
    rng = np.random.default_rng(2)
    bones, positions, follows = random_transforms(rng, 2, 5), rng.normal(size=(7, 3)), rng.integers(0, 5, size=7)
    posed = pose_nodes(bones, follows, positions)
    assert posed.shape == (2, 7, 3, 4)
    for sample in range(2):
        for node in range(7):
            at_rest = homogeneous(np.c_[np.eye(3), positions[node]])
            expected = homogeneous(bones[sample, follows[node]]) @ at_rest
            np.testing.assert_allclose(homogeneous(posed[sample, node]), expected, atol=1e-12)
