"""A root that moves: what garments are given of it against the reference, and what messages may do."""

import math

import numpy as np
import pytest
from native_frames import NativeFrameInput
from reference.frame_input import ReferenceFrameInput
from reference.root_tracker import LARGEST_GAP
from scipy.spatial.transform import Rotation

from physkin_core.runtime.frame_input import FrameInput

STILL = (0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0)
GRAVITY, MOVES, VELOCITY, TURNING = slice(0, 3), 6, slice(7, 10), slice(10, 13)


def rooted(position, orientation=(0.0, 0.0, 0.0, 1.0)):
    return np.array([*position, *orientation])


def strolling(t):
    """Position of a root that walks, sways and stops."""
    ahead = 1.2 * min(t, 2.0)
    return np.array([ahead, 0.08 * math.sin(2 * math.pi * 1.3 * t), 0.9 + 0.03 * math.cos(2 * math.pi * 2.0 * t)])


def turned(angle, position=(0, 0, 0.9)):
    return rooted(position, Rotation.from_euler("z", angle).as_quat())


class Moving:
    """Rows of one garment."""

    def __init__(self):
        self._input = FrameInput(1)
        self.reset = self._input.reset

    def row(self, time, root):
        """(13,)."""
        self._input.fill(time=time, root=root)
        return self._input.rows[0].astype(np.float64)


def test_rows_are_those_of_the_reference():
    """As much as each garment is told to sway, over frames at several rates, doubled, gaps, jumps, clocks that go back,
    changing wind, and a root of any speed."""
    generator, amounts = np.random.default_rng(3), (1.0, 0.4, 0.0)
    native, reference = NativeFrameInput(3), ReferenceFrameInput()
    t, turn, wind, seen = 0.0, Rotation.identity(), np.zeros(3), []
    for _ in range(400):
        t += generator.choice([1 / 120, 1 / 60, 1 / 15, 0.28, 0.0, -0.1, 0.5])
        turn = turn * Rotation.from_rotvec(generator.normal(size=3) * generator.choice([0.01, 0.1, 0.2, 2.0]))
        scale = generator.choice([0.01, 0.1, 2.0, 1e6], p=[0.4, 0.3, 0.28, 0.02])
        root = rooted(generator.normal(size=3) * scale, turn.as_quat())
        if generator.uniform() < 0.2:
            wind = generator.normal(size=3)
            wind *= generator.uniform(0, 13) / np.linalg.norm(wind)
        found, expected = (each.rows(t, root, amounts, wind) for each in (native, reference))
        np.testing.assert_allclose(found, expected, atol=1e-6, rtol=1e-6)
        seen.append(np.abs(expected))
    largest, known = np.max(seen, axis=0), np.mean(seen, axis=0)[0, MOVES]
    assert largest[0, 7] == 1e6 and largest[0, :3].max() > 2 and 0.1 < known < 0.9


@pytest.mark.parametrize("rate, sign", [(15, 1), (30, 1), (60, 1), (60, -1), (120, 1)])
def test_at_any_rate_it_moves_as_fast(rate, sign):
    """Velocity and turning are in the root's frame, half a frame late; a quaternion and its negative are one turn."""
    moving = Moving()
    for k in range(rate + 1):
        t = k / rate
        root = turned(0.5 + 2 * t, (1.4 * math.cos(0.5), 1.4 * math.sin(0.5), 0.0) * np.full(3, t))
        root[3:] *= sign**k
        row = moving.row(t, root)
    ahead = Rotation.from_euler("z", -2.0).apply([1.4, 0, 0])  # it walks on as it faced at first
    assert row[VELOCITY] == pytest.approx(ahead, abs=1e-5) and row[TURNING] == pytest.approx([0, 0, 2], abs=1e-5)
    assert row[MOVES] == 1 and row[GRAVITY] == pytest.approx([0, 0, -1], abs=1e-7)


def test_a_root_that_stands_has_a_velocity_that_is_known_and_zero():
    moving = Moving()
    first, second = moving.row(0.0, STILL), moving.row(1 / 60, STILL)
    assert first[MOVES] == 0 and second[MOVES] == 1 and not second[VELOCITY].any() and not second[TURNING].any()


@pytest.mark.parametrize("disturbance", ["gap", "jump", "turn", "back"])
def test_after_a_disturbance_nothing_is_known_of_the_motion_for_one_frame(disturbance):
    """And then what is true; the disturbance itself is never taken for a velocity."""
    moving, t, shift, about = Moving(), 0.0, np.zeros(3), 0.0
    for k in range(60):
        t += 1 / 60
        if k == 30:
            t += {"gap": 2 * LARGEST_GAP, "back": -5.0}.get(disturbance, 0.0)
            shift += {"jump": [0.0, 5.0, 0.0]}.get(disturbance, [0.0, 0.0, 0.0])
            about += 2.5 * (disturbance == "turn")
        row = moving.row(t, turned(about, strolling(k / 60) + shift))
        assert row[MOVES] == (k not in (0, 30))
        assert np.linalg.norm(row[VELOCITY]) < 2 and np.linalg.norm(row[TURNING]) < 1e-6
        assert row[VELOCITY].any() == row[MOVES]


def test_a_message_that_comes_twice_says_the_same():
    moving = Moving()
    for k in range(20):
        row = moving.row(k / 60, rooted(strolling(k / 60)))
        again = moving.row(k / 60, rooted((9, 9, 9)))
        assert again[5] == 0 or k == 0, "no time has passed for a sway network"
        assert (np.delete(again, 5) == np.delete(row, 5)).all()


def test_a_lost_message_changes_little():
    whole, lossy = Moving(), Moving()
    for k in range(60):
        row = whole.row(k / 60, rooted(strolling(k / 60)))
        if k % 5:
            found = lossy.row(k / 60, rooted(strolling(k / 60)))
            assert np.abs(found[VELOCITY] - row[VELOCITY]).max() < 0.06 or k == 1
    assert found[MOVES] == 1


def test_an_hour_of_anything_stays_finite_and_bounded():
    generator, moving, t = np.random.default_rng(0), Moving(), 0.0
    steps = generator.choice([1e-9, 1 / 120, 1 / 60, 0.2, 3.0, -1.0, 0.0], size=20000)
    places = generator.normal(size=(20000, 3)) * generator.choice([1e-3, 1.0, 1e6], size=(20000, 1))
    turns = Rotation.random(20000, random_state=1).as_quat()
    for step, place, turn in zip(steps, places, turns):
        t += step
        row = moving.row(t, rooted(place, turn))
        assert np.isfinite(row).all() and np.linalg.norm(row[GRAVITY]) <= 1 + 1e-6
        assert np.abs(row[VELOCITY]).max() <= 1e6


def test_reset_forgets():
    moving, fresh = Moving(), Moving()
    for k in range(60):
        moving.row(k / 60, rooted(strolling(k / 60)))
    moving.reset()
    assert (moving.row(1.0, STILL) == fresh.row(1.0, STILL)).all()
