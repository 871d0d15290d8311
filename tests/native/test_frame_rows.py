"""What garments are told of a frame: what changes nothing, what is refused, and that what is refused does not count."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told

MOVING = dict(sway=1.0, elapsed=0.02, moves=1.0, passed=0.02)
SWAY = ("sway_joints", "sway_layers", "sway_rates", "sway_turns")


@pytest.fixture
def garment(make_garment):
    return make_garment(np.random.default_rng(5), learnt_sway=True)


@pytest.fixture
def pose(garment, make_pose):
    return make_pose(np.random.default_rng(6), garment)


def drape(frame, garment, positions, row):
    (cloud,) = clouds(frame, [garment], positions, row)
    return cloud


@pytest.mark.parametrize("precision", ["bf16", "int8"])
def test_rounded_network_weights_sway_alike(precision, garment, make_frames):
    exact, rounded, without = (NativeFrame([garment], precision=each) for each in ("fp32", precision, "fp32"))
    without_rounded, offsets, errors = NativeFrame([garment], precision=precision), [], []
    for positions, row in make_frames(np.random.default_rng(7), garment, 60):
        for frame in (exact, rounded):
            drape(frame, garment, positions, row)
        for frame in (without, without_rounded):
            drape(frame, garment, positions, told(row[:3]))
        offsets.append(exact.corrections() - without.corrections())
        errors.append(rounded.corrections() - without_rounded.corrections() - offsets[-1])
    assert np.sqrt(np.square(errors).mean()) < 0.03 * np.sqrt(np.square(offsets).mean())


def test_what_moves_nothing_is_bit_for_bit_the_drape_by_itself(garment, pose):
    """Time alone; a sway where no network sways; no sway, whatever swung before."""
    positions, gravity = pose
    plain = drape(NativeFrame([garment]), garment, positions, told(gravity))
    none = {name: getattr(garment, name)[:0] for name in SWAY}
    still = replace(garment, **none)
    for bound, row in ((garment, told(gravity, elapsed=0.1, passed=0.1)), (still, told(gravity, **MOVING))):
        assert (drape(NativeFrame([bound]), bound, positions, row) == plain).all()
    swung = NativeFrame([garment])
    assert np.abs(drape(swung, garment, positions, told(gravity, sway=1.0)) - plain).max() > 1e-3
    assert (drape(swung, garment, positions, told(gravity)) == plain).all()


def test_after_a_jump_of_a_joint_the_pose_is_draped_as_it_is(garment, pose):
    positions, gravity = pose
    far, frame = positions.copy(), NativeFrame([garment])
    far[0] += 0.6
    drape(frame, garment, positions, told(gravity))
    row = told(gravity, passed=1e-3)
    assert (drape(frame, garment, far, row) == drape(NativeFrame([garment]), garment, far, row)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused_and_do_not_count(bad, garment, pose):
    """Of an outfit they are refused, too."""
    positions, gravity = pose
    row = told(gravity, **MOVING)
    for bounds in ([garment], [garment, garment]):
        frame, other = NativeFrame(bounds), NativeFrame(bounds)
        for each in (frame, other):
            clouds(each, bounds, positions, row)
        for index in range(13):
            wrong = row.copy()
            wrong[index] = bad
            with pytest.raises(ValueError, match=f"is {bad}.*finite"):
                clouds(frame, bounds, positions, wrong)
        if len(bounds) == 1:
            again = [clouds(each, bounds, 0.9 * positions, row) for each in (frame, other)]
            assert all((a == b).all() for a, b in zip(*again))


def test_a_joint_that_was_no_number_has_jumped(garment, pose):
    """In an outfit, which poses its bones before it looks."""
    positions, gravity = pose
    far, bounds, row = positions + np.float32(1.0), [garment] * 2, told(gravity, passed=1e-3)
    frame, fresh = NativeFrame(bounds), NativeFrame(bounds)
    clouds(frame, bounds, positions, row)
    with pytest.raises(ValueError, match="finite"):
        clouds(frame, bounds, positions * np.float32(np.nan), row)
    assert (clouds(frame, bounds, far, row)[0] == clouds(fresh, bounds, far, row)[0]).all()


def test_after_networks_that_are_refused_it_begins_anew(garment, pose):
    positions, gravity = pose
    frame, row = NativeFrame([garment]), told(gravity, **MOVING)
    drape(frame, garment, 0.5 * positions, row)
    with pytest.raises(ValueError, match="corrections of garment nodes"):
        drape(frame, garment, positions, told(1e30 * gravity, **MOVING))
    found, fresh = (drape(each, garment, positions, row) for each in (frame, NativeFrame([garment])))
    assert np.isfinite(found).all() and np.abs(found - fresh).max() < 1e-6


@pytest.mark.parametrize("wrong", [(1, 12), (3, 14), (1, 4), (3, 6)])
def test_rows_of_another_size_are_refused(wrong, garment, pose):
    outs = [np.empty((len(garment.vertices), 6), dtype=np.float32) for _ in range(3)]
    for count in (1, 3):
        with pytest.raises(ValueError, match="must have shape"):
            NativeFrame([garment] * count).evaluate(pose[0], np.zeros(wrong, np.float32), outs[:count])


def test_hours_of_anything_stay_finite(garment, make_frames):
    """Rates and joint positions of any size a float has."""
    rng = np.random.default_rng(12)
    frame = NativeFrame([garment])
    for k, (positions, row) in enumerate(make_frames(rng, garment, 5_000)):
        if k % 12 == 0:
            row[5] = rng.choice([1e-45, 1e-30, 1e30])
            row[7:] = rng.choice([-3e38, 0, 3e38], size=6)
            positions = rng.choice(np.array([-3e38, 0, 3e38], np.float32), size=len(positions))
        assert np.isfinite(drape(frame, garment, positions, row)).all()


# --- Sway networks that do not fit ---


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sway_layers": ()}, "without sway_layers"),
        ({"sway_rates": np.zeros(10, np.float32)}, r"sway_rates\[0\] is 0.0+; must be above 0"),
        ({"sway_turns": np.zeros(9, np.float32)}, "sway_turns must be"),
        ({"sway_joints": np.array([0, 1, 2, 7], np.int32)}, r"sway_joints\[3\] is 7; must be in \[0, 7\)"),
        ({"sway_joints": np.arange(3, dtype=np.int32)}, r"sway_layers of the drive\[0\] has 23 inputs; expected 21"),
    ],
)
def test_bound_garments_that_do_not_fit_are_refused(changes, said, garment):
    with pytest.raises(ValueError, match=said):
        NativeFrame([replace(garment, **changes)])


def test_layers_that_do_not_fit_are_refused(garment):
    first, driven, read, last, out = garment.sway_layers
    for layers, said in (
        ((first, driven, read, last), "sway_layers are 4; expected none or 5"),
        ((first, tuple(each[:-1] for each in driven), read, last, out), "gives 29 values; expected 3 for each"),
        ((first, driven, read, last, tuple(each[:-1] for each in out)), "give 71 values; expected 12"),
    ):
        with pytest.raises(ValueError, match=said):
            NativeFrame([replace(garment, sway_layers=layers)])
