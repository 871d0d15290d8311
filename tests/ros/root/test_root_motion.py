"""How a root moves, by its messages."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import FrameInput
from physkin_ros.root.quaternions import OrientationError
from physkin_ros.root.root_motion import RootMotion

SECOND = 1_000_000_000
LEANING = (0.0, np.sin(0.2), 0.0, np.cos(0.2))


def row_of(sample) -> np.ndarray:
    """What a garment is given (1, 13) of a sample."""
    frame_input = FrameInput(1)
    frame_input.set_root_sample(sample)
    return frame_input.rows.copy()


def test_it_moves_cloth_as_the_same_time_and_root():
    """Bit for bit; a quaternion a little off is taken as it is meant; without stamp, or when the root is to be still,
    the direction alone."""
    motion, told = RootMotion(), FrameInput(1)
    for k in range(30):
        stamp, place = SECOND + k * SECOND // 60, (k * k / 900, 0.0, 1.0)
        down, sample = motion.move(stamp, place, LEANING)
        told.set_root(1e-9 * stamp, np.array([*place, *LEANING]))
        np.testing.assert_array_equal(row_of(sample), told.rows)
        np.testing.assert_allclose(down, [np.sin(0.4), 0, -np.cos(0.4)])
    np.testing.assert_allclose(told.rows[0, :3], down, atol=1e-6)
    assert told.rows[0, 7] > 1, "it is fast by now"
    down, sample = motion.move(stamp, place, tuple(1.01 * number for number in LEANING))
    np.testing.assert_allclose(down, [np.sin(0.4), 0, -np.cos(0.4)])
    assert sample.known and motion.move(0, place, LEANING)[1] is None
    motion.still()
    assert motion.move(2 * SECOND, place, LEANING)[1] is None


def test_stamps():
    """A doubled message says the same again; a late one is told; a clock that begins anew is followed."""
    motion = RootMotion()
    for place in ((0, 0, 0), (1, 0, 0)):
        np.testing.assert_array_equal(*(row_of(motion.move(10 * SECOND, place, LEANING)[1]) for _ in range(2)))
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
    motion, other = RootMotion(), RootMotion()
    for k in range(20):
        stamp = SECOND + k * SECOND // 50
        if k == 10:
            with pytest.raises(ValueError, match=told):
                motion.move(stamp - 1000, place, turn)
        answers = [row_of(each.move(stamp, (k * k / 400, 0, 0), LEANING)[1]) for each in (motion, other)]
        np.testing.assert_array_equal(*answers)
