"""A frame in one native call: what its arguments may be, what it makes, and what a refused one leaves as it was."""

import pickle
import sys
import tracemalloc
from types import MappingProxyType

import numpy as np
import pytest
from random_models import SIZES, random_avatar, random_model, random_pose

from physkin_core import Draper, FrameInput
from physkin_core.runtime.evaluator import Evaluator
from physkin_core.runtime.frame_input import unit_direction

DOWN = np.array([0.6, 0.0, -0.8])


@pytest.fixture(scope="module")
def draper():
    rng = np.random.default_rng(2)
    model = random_model(rng, **SIZES["tiny"])
    return Draper(model, random_avatar(rng, model.rig))


@pytest.fixture
def pose(draper):
    """Joint positions (d,) float32 of which no two are the same."""
    return random_pose(np.random.default_rng(5), draper.model.rig)[0]


def misaligned(array):
    """The same numbers, one byte off where their type belongs."""
    buffer = np.zeros(array.nbytes + 1, dtype=np.uint8)
    moved = buffer[1:].view(array.dtype)
    moved[:] = array
    return moved


FORMS = {
    "float64": lambda row: row.astype(np.float64),
    "longer": lambda row: row.astype(np.longdouble),
    "other bytes": lambda row: row.astype(row.dtype.newbyteorder()),
    "unpickled": lambda row: pickle.loads(pickle.dumps(row)),
    "backwards": lambda row: row[::-1].copy()[::-1],
    "a column": lambda row: np.stack([row, row + 1], axis=1)[:, 0],
    "misaligned": misaligned,
    "read-only": lambda row: np.frombuffer(row.tobytes(), dtype=row.dtype),
    "a subclass": lambda row: row.view(np.recarray),
    "a list": lambda row: row.tolist(),
    "NumPy's numbers": lambda row: tuple(row),
}


@pytest.mark.parametrize("form", FORMS)
def test_numbers_come_in_any_form(form, draper, pose):
    """Joint positions, gravity and root, bit for bit."""
    take, root = FORMS[form], np.array([0, 0, 0.9, 0, 0, np.sin(0.1), np.cos(0.1)], dtype=np.float32)
    expected = draper.drape(pose, DOWN.astype(np.float32))
    np.testing.assert_array_equal(draper.drape(take(pose), take(DOWN.astype(np.float32))), expected)
    expected = draper.drape(pose, time=0.0, root=root)
    draper.reset()
    np.testing.assert_array_equal(draper.drape(take(pose), time=0, root=take(root)), expected)
    draper.reset()


def test_positions_by_name_are_those_by_order(draper, pose):
    """Whatever numbers they are, and in any mapping; those left out are at rest, also after a refused one."""
    names = draper.joint_names
    expected = draper.drape(pose)
    for numbers in (pose, pose.astype(np.float64), pose.tolist(), [np.array(value) for value in pose]):
        by_name = dict(zip(names, numbers))
        np.testing.assert_array_equal(draper.drape(by_name), expected)
        np.testing.assert_array_equal(draper.drape(MappingProxyType(by_name)), expected)
    some, rest = dict(zip(names[1:], pose[1:])), draper.model.rig.rest.astype(np.float32)
    for wrong, said in (({**some, "elbow": 0.4}, "no joint 'elbow'"), ({**some, names[0]: np.nan}, "is nan")):
        with pytest.raises(ValueError, match=said):
            draper.drape(wrong)
    with pytest.raises((TypeError, ValueError)):
        draper.drape({names[0]: "bent"})
    for given in (some, {}):
        by_order = np.array([given.get(name, at_rest) for name, at_rest in zip(names, rest)], dtype=np.float32)
        np.testing.assert_array_equal(draper.drape(given), draper.drape(by_order))


def test_a_frame_is_one_call(draper, pose):
    """Python enters no function but `drape` itself, and makes no array that was not asked for."""
    out, root, outs = np.zeros((draper.vertex_count, 6), np.float32), np.array([0, 0, 0.9, 0, 0, 0, 1]), []
    outs.append(out)
    by_name, outfit = dict(zip(draper.joint_names, pose.tolist())), draper.outfit
    calls = []

    def note(frame, event, argument):
        if event in ("call", "c_call"):
            calls.append(frame.f_code.co_name if event == "call" else argument)

    for positions in (pose, pose.astype(np.float64), by_name):
        for given in ({"gravity": DOWN}, {"effective_gravity": 9 * DOWN}, {"time": 1.0, "root": root}):
            outfit.drape(positions, **given, outs=outs)
            calls.clear()
            sys.setprofile(note)
            try:
                outfit.drape(positions, **given, outs=outs)
            finally:
                sys.setprofile(None)
            assert calls[:-1] == ["drape"], "the last is what ends the profile"
            tracemalloc.start()
            try:
                outfit.drape(positions, **given, outs=outs)
                peak = tracemalloc.get_traced_memory()[1]
            finally:
                tracemalloc.stop()
            assert peak < 500, "a list of clouds, a bound method and numbers; not even an array of positions"
    draper.reset()


def test_a_new_cloud_is_the_caller_s(draper, pose):
    """Later frames leave it alone."""
    first = draper.drape(pose)
    kept = first.copy()
    second = draper.drape(-pose)
    assert not np.shares_memory(first, second) and first.flags.owndata and first.flags.writeable
    np.testing.assert_array_equal(first, kept)
    assert np.abs(first - second).max() > 1e-3


@pytest.mark.parametrize("columns", [3, 6])
def test_an_output_of_any_layout_is_written(columns, draper, pose):
    """Rows backwards, apart, misaligned, of a dtype that was unpickled or that is no array of NumPy."""
    expected, n = draper.drape(pose)[:, :columns], draper.vertex_count
    outs = [
        np.zeros((2 * n, columns), np.float32)[::-2],
        np.zeros((n, 11), np.float32)[:, 2 : 2 + columns],
        misaligned(np.zeros(columns * n, np.float32)).reshape(n, columns),
        pickle.loads(pickle.dumps(np.zeros((n, columns), np.float32))),
        memoryview(np.zeros((n, columns), np.float32)),
    ]
    for out in outs:
        assert draper.drape(pose, out=out) is out
        np.testing.assert_array_equal(np.asarray(out), expected)


def test_an_output_that_cannot_be_written_is_described(draper, pose):
    n = draper.vertex_count
    read_only = np.zeros((n, 6), np.float32)
    read_only.flags.writeable = False
    wrong = {
        "float64 of shape": np.zeros((n, 6)),
        "read-only float32 of shape": read_only,
        "float32 of shape": np.zeros(6 * n, np.float32),
        "list": [[0.0] * 6] * n,
    }
    for said, out in wrong.items():
        with pytest.raises(TypeError, match=f"out must be a writable float32 array of two dimensions, got {said}"):
            draper.drape(pose, out=out)


def test_a_refused_frame_is_as_if_it_had_not_been_asked_for(draper, pose):
    """Neither wrong positions nor a wrong output take time away from the next frame."""
    outfit, undisturbed = draper.outfit.twin(), draper.outfit.twin()
    root = np.array([0, 0, 0.9, 0, 0, 0, 1.0])
    for k in range(4):
        root[0] = 0.05 * k * k
        frame = {"time": k / 60, "root": root}
        with pytest.raises(ValueError, match="must be finite"):
            outfit.drape(pose * np.nan, **frame)
        with pytest.raises(TypeError, match="out must be"):
            outfit.drape(pose, **frame, outs=[None])
        np.testing.assert_array_equal(outfit.drape(pose, **frame), undisturbed.drape(pose, **frame))
        np.testing.assert_array_equal(outfit.frame_input.rows, undisturbed.frame_input.rows)


def test_a_unit_direction_of_any_length():
    for size in (2e-9, 1.0, 1e150, 1e300):
        np.testing.assert_allclose(unit_direction(size * DOWN), DOWN, rtol=1e-15)
    for wrong in (1e-10 * DOWN, [0, 0, np.inf], [0, np.nan, 1], [0, 1], [[0, 0, 1]], 1.0):
        with pytest.raises(ValueError, match=r"gravity must be a finite, non-zero direction \(3,\), got "):
            unit_direction(wrong)


def test_frames_need_what_is_of_their_garments(draper):
    evaluator, rest = Evaluator([draper.bound]), draper.bound.dof_rest
    with pytest.raises(ValueError, match="inputs for 2 of 1 garments"):
        evaluator.frames(FrameInput(2), rest)
    with pytest.raises(ValueError, match=rf"rest must have shape \({len(rest)},\)"):
        evaluator.frames(FrameInput(1), rest[:-1])
    with pytest.raises(ValueError, match=rf"joint_positions must have shape \({len(rest)},\)"):
        evaluator.frames(FrameInput(1), rest).drape(rest[:-1], np.asarray, DOWN, None, None, None, None)
