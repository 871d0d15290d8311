"""Where a root is and how it moves, by its messages."""

from __future__ import annotations

import numpy as np
import pytest
from root_messages import odometry, pose

from physkin_core import FrameInput
from physkin_ros.root.quaternions import OrientationError
from physkin_ros.root.root_orientation import RootOrientation

LEANING = (0.0, np.sin(0.2), 0.0, np.cos(0.2))
DOWN = [np.sin(0.4), 0, -np.cos(0.4)]


class Told(RootOrientation):
    """down: the last direction (3,). rows: what a garment is given of each motion (13,). known: of the last one."""

    def __init__(self) -> None:
        self.rows, self.down = [], None
        super().__init__(self._on_down, self._on_motion)

    def _on_down(self, down, stamp) -> None:
        self.down = down

    def _on_motion(self, sample, stamp) -> None:
        frame_input = FrameInput(1)
        frame_input.set_root_sample(sample)
        self.rows.append(frame_input.rows[0].copy())


def test_it_moves_cloth_as_the_same_time_and_root():
    """Bit for bit; a quaternion a little off is taken as it is meant; without stamp, or when the root is to be still,
    the direction alone."""
    root, told = Told(), FrameInput(1)
    for k in range(30):
        seconds, place = round(1 + k / 60, 9), (k * k / 900, 0.0, 1.0)
        (root.pose if k % 2 else root.odometry)((pose if k % 2 else odometry)(seconds, place, LEANING))
        told.set_root(1e-9 * round(1e9 * seconds), np.array([*place, *LEANING]))
        np.testing.assert_array_equal(root.rows[-1], told.rows[0])
        np.testing.assert_allclose(root.down, DOWN, rtol=1e-6)
    assert told.rows[0, 7] > 1, "it is fast by now"
    root.pose(pose(seconds, place, tuple(1.01 * number for number in LEANING)))
    np.testing.assert_allclose(root.down, DOWN, rtol=1e-6)
    root.pose(pose(0, place, LEANING))
    root.still()
    root.pose(pose(2, place, LEANING))
    assert len(root.rows) == 31


def test_stamps():
    """A doubled message says the same again; a late one is told; a clock that begins anew is followed."""
    root = Told()
    for place in ((0, 0, 0), (1, 0, 0)):
        root.pose(pose(10, place, LEANING))
        root.pose(pose(10, place, LEANING))
        np.testing.assert_array_equal(*root.rows[-2:])
    with pytest.raises(OrientationError, match="stamped 0.250 s back"):
        root.pose(pose(9.75, (0, 0, 0), LEANING))
    for seconds in (10.1, 5, 0, 5.1):
        root.pose(pose(seconds, (0, 0, 0), LEANING))


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
    root, other = Told(), Told()
    for k in range(20):
        if k == 10:
            with pytest.raises(ValueError, match=told):
                root.pose(pose(1 + k / 50 - 1e-6, place, turn))
        for each in (root, other):
            each.pose(pose(1 + k / 50, (k * k / 400, 0, 0), LEANING))
    np.testing.assert_array_equal(root.rows, other.rows)
