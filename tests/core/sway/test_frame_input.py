"""What garments are given of a frame, as far as gravity and time go."""

import numpy as np
import pytest
from native_frames import told
from scipy.spatial.transform import Rotation

from physkin_core import FrameInput
from physkin_core.runtime.frame_input import RootTracker

DOWN = np.array([0.6, 0.0, -0.8])
STANDS_ALONE = -2.0
STANDING = (0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0)


def rows(garments, **given):
    frame_input = FrameInput(garments)
    frame_input.fill(**given)
    return frame_input.rows


def test_a_frame_that_stands_by_itself_has_gravity_alone():
    """Of any length but zero; effective gravity is in units of gravity."""
    expected = np.stack([told(DOWN, passed=STANDS_ALONE)] * 2)
    for given in ({"gravity": DOWN}, {"gravity": 1e3 * DOWN}, {"effective_gravity": 9.81 * DOWN}):
        np.testing.assert_allclose(rows(2, **given), expected, atol=1e-7)
    assert not rows(1, effective_gravity=np.zeros(3))[0, :3].any()


def test_each_garment_feels_as_much_of_an_acceleration_as_it_sways():
    """Of what differs from a root at rest, where that is known. A sway network goes on, of a root whose velocity is not
    known, under that gravity."""
    frame_input = FrameInput(3)
    frame_input.sway = (1.0, 0.5, 0.0)
    felt, at_rest = np.array([3.0, 0.0, -8.0]), np.array([0.0, 0.0, -9.81])
    for time in (1.0, 1.02):
        frame_input.set_effective_gravity(felt, at_rest)
        frame_input.begin_frame(time)
    half = (felt + at_rest) / 2
    np.testing.assert_allclose(9.81 * frame_input.rows[:, :3], [felt, half, at_rest], atol=1e-6)
    np.testing.assert_allclose(frame_input.rows[:2, 3:7], [[0.02, 1, 0.02, 1], [0.02, 0.5, 0.02, 1]], atol=1e-6)
    assert not frame_input.rows[:, 7:].any()
    frame_input.set_effective_gravity(felt)
    np.testing.assert_allclose(9.81 * frame_input.rows[:, :3], [felt] * 3, atol=1e-6)


def test_a_root_that_is_tracked_elsewhere_is_followed():
    """As one of its own; of its first pose no rates are known."""
    own, follows, tracker = FrameInput(2), FrameInput(2), RootTracker()
    for k in range(20):
        root = np.array([0.01 * k * k, 0, 0.9, *Rotation.from_euler("z", 0.05 * k).as_quat()])
        sample = tracker.move(k / 60, root)
        assert sample.known == (k > 0)
        follows.set_root_sample(sample)
        follows.begin_frame(k / 60)
        own.fill(time=k / 60, root=root)
        np.testing.assert_array_equal(follows.rows, own.rows)
    assert own.rows[1, 7] > 1 and own.rows[1, 12] == pytest.approx(3)


def test_a_frame_without_a_time_ends_what_was_before():
    """The next one is as a first one, whatever time it is."""
    moved, fresh = FrameInput(2), FrameInput(2)
    for k in range(20):
        root = np.array([0.01 * k * k, 0, 0.9, *Rotation.from_euler("z", 0.05 * k).as_quat()])
        moved.fill(time=k / 60, root=root)
    before = moved.rows.copy()
    moved.fill()
    for each in (moved, fresh):
        each.fill(time=20 / 60, root=root)
    np.testing.assert_array_equal(moved.rows, fresh.rows)
    assert np.abs(moved.rows - before).max() > 0.1


NAN, INF = np.nan, np.inf
REFUSED = [
    *(
        ("set_gravity", wrong, r"gravity must be a unit direction \(3,\), got \[")
        for wrong in (1.01 * DOWN, np.zeros(3), [0, 0, NAN])
    ),
    ("set_gravity", DOWN[:2], r"gravity must have shape \(3,\)"),
    *(
        ("set_effective_gravity", wrong, r"effective_gravity must be .* up to 29.4 m/s2 long, got \[")
        for wrong in ([0, 0, -29.5], [0, NAN, 0], [NAN, 0, 0], [0, 0, NAN], [0, INF, 0])
    ),
    ("begin_frame", NAN, "time must be finite, got nan"),
    ("begin_frame", INF, "time must be finite, got inf"),
    ("set_root", (INF, STANDING), "time must be finite, got inf"),
    ("set_root", (NAN, STANDING), "time must be finite, got nan"),
    ("set_root", (0.0, (*STANDING[:6], INF)), "finite"),
    ("set_root", (0.0, STANDING[:6]), "shape"),
    ("set_root", (0.0, (1e12, *STANDING[1:])), "within"),
    ("set_root", (0.0, (0, 0, 0, 0, 0, 0, 0)), "length 1"),
    ("wind", (13.1, 0, 0), r"up to 13 m/s, got \[13.1, 0.0, 0.0\]"),
    ("wind", (0, NAN, 0), "finite, up to 13 m/s"),
    ("wind", (0, 0, INF), "finite, up to 13 m/s"),
    ("wind", (1.0, 0.0), r"wind must have shape \(3,\)"),
    ("wind", 3.0, r"wind must have shape \(3,\)"),
    ("wind", np.zeros((1, 3)), "rows of numbers"),
    *(
        ("sway", [wrong], "must be a number from 0 to 1, got")
        for wrong in (-0.1, 1.1, NAN, "all", None, np.array(0.5), np.array([0.5]))
    ),
    ("sway", (1.0, 1.0), "sway has 2 numbers; expected one for each of 1 garments"),
]


@pytest.mark.parametrize(("name", "wrong", "said"), REFUSED)
def test_what_is_refused(name, wrong, said):
    """What was known before stays."""
    frame_input = FrameInput(1)
    frame_input.wind, frame_input.sway = (3.0, -2.0, 0.5), [0.5]
    with pytest.raises(ValueError, match=said):
        if name in ("wind", "sway"):
            setattr(frame_input, name, wrong)
        else:
            getattr(frame_input, name)(*(wrong if isinstance(wrong, tuple) else [wrong]))
    assert frame_input.wind == (3.0, -2.0, 0.5) and frame_input.sway == (0.5,)


@pytest.mark.parametrize("none", [0, -1])
def test_garments_are_counted(none):
    with pytest.raises(ValueError, match=f"garments is {none}; there must be 1 or more"):
        FrameInput(none)
