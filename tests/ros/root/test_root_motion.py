"""A root that moves, and what it feels."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import Sway
from physkin_ros.root.quaternions import OrientationError
from physkin_ros.root.root_motion import RootMotion

SECOND = 1_000_000_000
LEANING = (0.0, np.sin(0.2), 0.0, np.cos(0.2))


def test_it_feels_what_sway_says():
    """In units of gravity; a quaternion a little off is taken as it is meant; without sway or stamp the direction
    alone."""
    motion, still, sway = RootMotion([0.5]), RootMotion([0.0]), Sway(amount=0.5)
    for k in range(30):
        stamp, place = SECOND + k * SECOND // 60, (k * k / 900, 0.0, 1.0)
        down, felt = motion.move(stamp, place, tuple(1.01 * number for number in LEANING))
        (felt,) = felt.rows[:, :3]
        np.testing.assert_allclose(felt, sway.felt(1e-9 * stamp, (*place, *LEANING)) / 9.81, atol=1e-6)
        np.testing.assert_allclose(down, [np.sin(0.4), 0, -np.cos(0.4)])
        assert still.move(stamp, place, LEANING)[1] is None
    assert np.linalg.norm(felt - down) > 0.1
    assert motion.move(0, place, LEANING)[1] is None
    motion.still()
    assert motion.move(2 * SECOND, place, LEANING)[1] is None


def test_each_garment_feels_as_much_as_it_sways():
    """Leaning and twist; others from now on."""
    motion, alone = RootMotion([1.0, 0.0, 0.4]), [RootMotion([sway]) for sway in (1.0, 0.4)]
    for k in range(40):
        turn = (0.0, 0.0, np.sin(0.001 * k * k), np.cos(0.001 * k * k))
        stamp, place = SECOND + k * SECOND // 60, (k * k / 900, 0.0, 1.0)
        (_, felt), *others = (each.move(stamp, place, turn) for each in (motion, *alone))
        felt = felt.rows
        np.testing.assert_array_equal(felt[[0, 2]], [other.rows[0] for _, other in others])
        np.testing.assert_allclose(felt[1], [0, 0, -1, 0], atol=1e-9)
    assert felt[0, 3] < felt[2, 3] < -0.05 and abs(felt[0, 0]) > abs(felt[2, 0]) > 0.1
    motion.set_sway([0.0, 1.0, 0.0])
    np.testing.assert_allclose(motion.move(stamp, place, turn)[1].rows[[1, 0]], [felt[0], [0, 0, -1, 0]], atol=1e-9)


def test_stamps():
    """A doubled message says the same again; a late one is told; a clock that begins anew is followed."""
    motion = RootMotion([1.0])
    for place in ((0, 0, 0), (1, 0, 0)):
        np.testing.assert_array_equal(*(motion.move(10 * SECOND, place, LEANING)[1].rows for _ in range(2)))
    assert not motion.follows(10 * SECOND) and not motion.follows(9 * SECOND)
    with pytest.raises(OrientationError, match="stamped 0.250 s back"):
        motion.move(9 * SECOND + SECOND * 3 // 4, (0, 0, 0), LEANING)
    for stamp in (10 * SECOND + 1, 5 * SECOND, 0, 5 * SECOND + 1):
        assert motion.follows(stamp)
        motion.move(stamp, (0, 0, 0), LEANING)


@pytest.mark.parametrize(
    ("place", "turn", "told"),
    [
        ((np.nan, 0, 0), LEANING, "position is"),
        ((0, 0, np.inf), LEANING, "position is"),
        ((0, 0, 2e9), LEANING, "within 1e"),
        ((0, 0, 0), (0, 0, 0, 0), "unit quaternion"),
        ((0, 0, 0), (0, np.nan, 0, 1), "unit quaternion"),
    ],
)
def test_what_is_no_pose_changes_nothing(place, turn, told):
    motion, other = RootMotion([1.0]), RootMotion([1.0])
    for k in range(20):
        stamp = SECOND + k * SECOND // 50
        if k == 10:
            with pytest.raises(ValueError, match=told):
                motion.move(stamp - 1000, place, turn)
        answers = [each.move(stamp, (k * k / 400, 0, 0), LEANING)[1].rows for each in (motion, other)]
        np.testing.assert_array_equal(*answers)
