"""Wind: what it adds to the gravity that cloth is under, in every way that a frame is told of its root."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core.runtime.frame_input import AIR_DRAG, LARGEST_WIND, STANDARD_GRAVITY, FrameInput

WIND, DOWN = np.array([3.0, -2.0, 0.5]), np.array([0.0, 0.0, -1.0])
STILL = (0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0)
TURN = Rotation.from_euler("xyz", (0.4, -0.9, 2.0))


def blown(wind=WIND, *, sways=(1.0, 1.0)):
    frame_input = FrameInput(2)
    frame_input.sway, frame_input.wind = sways, wind
    return frame_input


def felt(frame_input, **given):
    """(g, 3) effective gravity in units of gravity."""
    frame_input.fill(**given)
    return frame_input.rows[:, :3].astype(np.float64)


def pull(wind=WIND):
    """Of air that drags at cloth by its speed."""
    return AIR_DRAG * np.asarray(wind) / STANDARD_GRAVITY


@pytest.mark.parametrize("sways", [(1.0, 1.0), (0.0, 0.0)])
def test_it_is_a_field_beside_gravity_in_the_world_however_cloth_sways(sways):
    turned = [0.0, 0.0, 0.9, *TURN.as_quat()]
    expected = TURN.inv().apply(DOWN + pull())
    np.testing.assert_allclose(felt(blown(sways=sways), time=0.0, root=turned), [expected] * 2, atol=1e-6)


def test_of_a_root_at_rest_it_is_in_the_level_frame_that_faces_as_it_does():
    np.testing.assert_allclose(felt(blown()), [DOWN + pull()] * 2, atol=1e-6)
    for axis, angle in (("y", -1.5), ("y", 1.5), ("x", 0.7), ("xyz", (0.3, -0.5, 0.0))):  # lies on its back and face
        tilt = Rotation.from_euler(axis, angle)
        level = Rotation.align_vectors([DOWN], [tilt.inv().apply(DOWN)])[0].inv()
        found = felt(blown(), gravity=tilt.inv().apply(DOWN))
        np.testing.assert_allclose(found, [level.apply(DOWN + pull())] * 2, atol=1e-6)
    upside_down = felt(blown(), gravity=-DOWN)
    np.testing.assert_allclose(upside_down, [(-DOWN) + pull() * [1, -1, -1]] * 2, atol=1e-6)


def test_an_acceleration_of_which_rest_is_known_goes_with_wind_and_an_effective_gravity_has_it_in_it():
    frame_input, given = blown(), np.array([1.0, 0.0, -9.0])
    frame_input.set_effective_gravity(given, STANDARD_GRAVITY * DOWN)
    frame_input.begin_frame(0.0)
    np.testing.assert_allclose(frame_input.rows[:, :3], [given / STANDARD_GRAVITY + pull()] * 2, atol=1e-6)
    np.testing.assert_allclose(felt(blown(), effective_gravity=given), [given / STANDARD_GRAVITY] * 2, atol=1e-6)


def test_cloth_never_feels_more_than_three_times_gravity():
    strongest = felt(blown((0.0, 0.0, -LARGEST_WIND)))
    assert np.linalg.norm(strongest, axis=1) == pytest.approx(2.999)
    across = felt(blown((LARGEST_WIND, 0.0, 0.0)))
    np.testing.assert_allclose(across, [DOWN + pull((LARGEST_WIND, 0, 0))] * 2, atol=1e-6)


@pytest.mark.parametrize("rate", [15, 60, 120])
def test_a_gust_takes_its_time_at_any_rate_and_what_changes_slowly_is_not_late(rate):
    frame_input = blown((0.0, 0.0, 0.0))
    felt(frame_input, time=0.0, root=STILL)
    frame_input.wind = (9.0, 0.0, 0.0)
    path = [felt(frame_input, time=k / rate, root=STILL)[0, 0] for k in range(1, rate + 1)]
    assert path[round(0.2 * rate) - 1] == pytest.approx(pull((6.0, 0, 0))[0], rel=1e-4), "30 m/s2"
    assert path[-1] == pytest.approx(pull((9.0, 0, 0))[0], rel=1e-6)
    again = felt(frame_input, time=1.0, root=STILL)[0, 0]
    frame_input.wind = (9.0 - 12 / rate, 0.0, 0.0)
    assert felt(frame_input, time=1.0, root=STILL)[0, 0] == again, "a doubled frame"
    assert felt(frame_input, time=1 + 1 / rate, root=STILL)[0, 0] == pytest.approx(pull((9 - 12 / rate, 0, 0))[0])


def test_where_nothing_goes_on_it_blows_at_once():
    frame_input = blown((0.0, 0.0, 0.0))
    felt(frame_input, time=0.0, root=STILL)
    frame_input.wind = WIND
    np.testing.assert_allclose(felt(frame_input), [DOWN + pull()] * 2, atol=1e-6)
    frame_input.wind = -WIND
    frame_input.reset()
    np.testing.assert_allclose(felt(frame_input, time=5.0, root=STILL), [DOWN - pull()] * 2, atol=1e-6)
