"""Gravity in the root frame, against rotation matrices."""

from __future__ import annotations

from types import SimpleNamespace as Message

import numpy as np
import pytest
from root_messages import turned, vector
from scipy.spatial.transform import Rotation

from physkin_ros.root.gravity import (
    FRESH,
    MOST_KEPT,
    FreshByStamp,
    LatestByStamp,
    gravity_from_imu,
    gravity_from_quaternion,
)
from physkin_ros.root.quaternions import OrientationError

DOWN = np.array([0.0, 0.0, -1.0])


def test_any_orientation():
    """The world's down, seen from the root; a quaternion a little off unit length is taken as it is meant."""
    for rotation in Rotation.random(50, rng=np.random.default_rng(1)):
        expected = rotation.inv().apply(DOWN)
        np.testing.assert_allclose(gravity_from_quaternion(rotation.as_quat()), expected, atol=1e-12)
        np.testing.assert_allclose(gravity_from_quaternion(1.01 * rotation.as_quat()), expected, atol=1e-12)


@pytest.mark.parametrize("wrong", [(0, 0, 0, 0), (0, 0, 0, 2), (np.nan, 0, 0, 1), (0, np.inf, 0, 1), (1e200, 0, 0, 0)])
def test_what_is_no_rotation_is_refused(wrong):
    """Among them the message nobody filled in."""
    with pytest.raises(OrientationError, match="must be a unit quaternion"):
        gravity_from_quaternion(wrong)


def test_imu():
    """Its orientation; without one, what it feels at rest."""
    rotation = Rotation.from_euler("xyz", [0.3, -0.4, 2.0])
    expected = rotation.inv().apply(DOWN)
    message = Message(
        orientation=turned(rotation.as_quat()), orientation_covariance=[0.0] * 9, linear_acceleration=vector([0.0] * 3)
    )
    np.testing.assert_allclose(gravity_from_imu(message), expected, atol=1e-12)
    message.orientation_covariance = [-1.0] + [0.0] * 8
    with pytest.raises(OrientationError, match="no orientation"):
        gravity_from_imu(message)
    message.linear_acceleration = vector(-9.81 * expected)
    np.testing.assert_allclose(gravity_from_imu(message), expected, atol=1e-12)


SECOND = 1_000_000_000


def test_directions_pair_by_stamp():
    """Whatever the order they come in; where no stamps tell, the last that came; a restarted clock starts anew."""
    kept = LatestByStamp(9)
    at = lambda seconds: kept.at(round(seconds * SECOND))  # noqa: E731
    assert at(5) == 9
    for entry, seconds in ((1, 10), (3, 10.2), (2, 10.1)):
        kept.add(entry, round(seconds * SECOND))
    asked = {10: 1, 10.15: 2, 10.2: 3, 99: 3, 9.5: 1, 8: 2, 0: 2}
    assert {seconds: at(seconds) for seconds in asked} == asked
    kept.add(4, 0)
    assert at(10.05) == 4
    for entry, seconds in ((5, 2_000_000_000), (6, 20)):
        kept.add(entry, seconds * SECOND)
    assert at(20.01) == at(3e9) == 6


def test_only_so_many_are_kept():
    """The earliest go."""
    kept = LatestByStamp(-1)
    for index in range(2 * MOST_KEPT):
        kept.add(index, SECOND + index)
    assert kept.at(SECOND + 5) == MOST_KEPT


def test_what_is_fresh_counts():
    """By when it came, whatever its stamps; paired by stamps as directions are, but never with what was stale."""
    kept = FreshByStamp()
    assert kept.at(5, 0) is None
    for entry, seconds in ((1, 10), (2, 10.2)):
        kept.add(entry, round(seconds * SECOND), 1000)
    for stamp, entry in ((10.1, 1), (10.2, 2), (0, 2)):
        assert kept.at(round(stamp * SECOND), 1000 + FRESH) == entry
        assert kept.at(round(stamp * SECOND), 1001 + FRESH) is None
    kept.add(3, 12 * SECOND, 2000 + FRESH)
    assert kept.at(round(11.5 * SECOND), 2000 + FRESH) == 3
