"""Clouds at a rate of their own."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_ros.node.interpolation import PoseInterpolator

MS = 1_000_000


def down(x, z):
    return np.float32([[x, 0, z]])


@pytest.fixture
def poses():
    return PoseInterpolator(2)


def sample(poses, now):
    stamp, pose, gravity = poses.sample(now)
    return stamp, pose, gravity[0]


def test_between_two(poses):
    """One joint state late, pose, stamp and gravity on the way; then it stops at the last."""
    poses.push(np.float32([0, 0]), down(0, -2), 1000, 0)
    poses.push(np.float32([4, -8]), down(-1, 0), 2000, 100 * MS)
    for now, share in ((100, 0.0), (125, 0.25), (150, 0.5), (200, 1.0)):
        stamp, pose, gravity = sample(poses, now * MS)
        assert stamp == 1000 + round(1000 * share)
        np.testing.assert_allclose(pose, [4 * share, -8 * share], atol=1e-6)
        assert np.linalg.norm(gravity) == pytest.approx(2 - share)
        np.testing.assert_allclose(gravity[0] * (1 - share), gravity[2] * share, atol=1e-6)
    assert poses.sample(201 * MS) is None


def test_after_a_gap_it_starts_anew(poses):
    """A tracker that lost the body for a second does not sweep it through the room."""
    poses.push(np.float32([0, 0]), down(0, -1), 1000, 0)
    poses.push(np.float32([4, 4]), down(0, -1), 2000, 1000 * MS)
    assert sample(poses, 1001 * MS)[1].tolist() == [4, 4]


def test_without_weight_the_last_direction_stays(poses):
    """From gravity to free fall it shrinks along its direction."""
    poses.push(np.float32([0, 0]), down(-1, 0), 0, 0)
    with np.errstate(all="raise"):
        poses.push(np.float32([0, 0]), down(0, 0), 10, 10 * MS)
    for now, share in ((15, 0.5), (20, 1.0)):
        assert sample(poses, now * MS)[2].tolist() == [share - 1, 0, 0]


def test_opposite_directions_of_gravity(poses):
    """Half way there is none: the later one is taken."""
    poses.push(np.float32([0, 0]), down(0, -1), 0, 0)
    poses.push(np.float32([0, 0]), down(0, 1), 10, 10 * MS)
    assert sample(poses, 15 * MS)[2].tolist() == [0, 0, 1]
