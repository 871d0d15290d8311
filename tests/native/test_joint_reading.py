"""Joint values read by native code: what is bound is checked once, and refused by what is wrong with it."""

from __future__ import annotations

import struct
import sys

import numpy as np
import pytest

from physkin_core import _native

START = np.float32([1, 2, 3])


def reading(source=(1, 0), target=(0, 2), scale=(2.0, 1.0), offset=(0.5, 0.0), *, swapped=False, start=START, out=None):
    return _native.JointReading(
        list(source),
        list(target),
        list(scale),
        list(offset),
        4,
        swapped,
        9.0,
        start,
        np.empty(3, np.float32) if out is None else out,
    )


@pytest.mark.parametrize("order", "<>")
def test_reads_ordinary_values_alone(order):
    """Over `start`; else nothing is changed and False returned, be it the last joint or the bytes that end early."""
    out = np.zeros(3, np.float32)
    read = reading(swapped=(order == "<") != (sys.byteorder == "little"), out=out).read
    message = b"head" + struct.pack(f"{order}3d", 7.0, 2.0, np.nan)
    for refused in (
        message[:19],
        b"",
        b"head" + struct.pack(f"{order}2d", np.nan, 2.0),
        b"head" + struct.pack(f"{order}2d", 1.0, 4.3),
    ):
        assert read(refused) is False and not out.any()
    assert read(message) is True
    np.testing.assert_array_equal(out, np.float32([4.5, 2, 7]))


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"target": (0,)}, r"target must have shape \(2,\)"),
        ({"scale": ()}, r"scale must have shape \(2,\)"),
        ({"offset": (1.0, 2.0, 3.0)}, r"offset must have shape \(2,\)"),
        ({"source": (1, -1)}, "joint 1 is taken from value -1 to position 2 of 3"),
        ({"target": (3, 0)}, "joint 0 is taken from value 1 to position 3 of 3"),
        ({"start": np.zeros(2, np.float32)}, r"start must have shape \(3,\)"),
    ],
)
def test_what_is_wrong_is_refused(wrong, reason):
    """Before anything is read."""
    with pytest.raises(ValueError, match=reason):
        reading(**wrong)


def test_only_arrays_that_are_the_callers_own():
    """Another dtype or stride would be read and written in a copy."""
    for out in (np.zeros(3), np.zeros(6, np.float32)[::2]):
        with pytest.raises(TypeError):
            reading(out=out)
    with pytest.raises(ValueError, match=r"most must have shape \(3,\)"):
        _native.PoseRange(START, np.zeros(3, np.float32), np.zeros(4, np.float32))


def test_beginning_of_a_message():
    """Compared where the mask says so; a shorter message begins otherwise."""
    beginning = _native.MessageBeginning(b"abcd", b"\xff\0\xff\xff")
    assert beginning.matches(b"abcd") and beginning.matches(b"a?cde")
    assert not (beginning.matches(b"abc") or beginning.matches(b"abce") or beginning.matches(b"?bcd"))
    with pytest.raises(ValueError, match="of one length"):
        _native.MessageBeginning(b"abcd", b"\xff")
