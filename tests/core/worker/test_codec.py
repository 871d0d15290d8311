"""What two processes can say to each other, and that nothing else is taken."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import pytest

from physkin_core.worker.codec import Codec, CodecError


@dataclass(frozen=True)
class Thing:
    """Checks what it is made of, and derives a field."""

    array: np.ndarray
    more: object = None
    total: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "total", float(self.array.sum()))


@dataclass(frozen=True)
class Stranger:
    """Not known to the codec."""

    name: str = ""


CODEC = Codec([Thing])


def there_and_back(value):
    """What the other side makes of it."""
    text, arrays = CODEC.encode(value)
    filled = CODEC.empty_arrays(text, 1 << 20)
    for array, content in zip(filled, arrays, strict=True):
        array[...] = content
    return CODEC.decode(text, filled)


@pytest.mark.parametrize("value", [None, True, 3, -0.5, "naïve \n", (), (1, ("a", None)), {"a": (1, 2.5)}, {}])
def test_plain_values(value):
    assert there_and_back(value) == value


def test_lists_become_tuples_and_numpy_scalars_numbers():
    assert there_and_back([1, [np.float32(0.5), np.int64(2), np.bool_(True)]]) == (1, (0.5, 2, True))


@pytest.mark.parametrize("dtype", ["f4", "f8", "i4", "u2", "?", [("x", "<f4"), ("colour", "u1")]])
@pytest.mark.parametrize("shape", [(3,), (0, 3), (), (2, 1, 3)])
def test_arrays_keep_type_shape_and_content(dtype, shape):
    array = np.zeros(shape, dtype=dtype)
    if array.dtype.names is None:
        array[...] = np.arange(array.size).reshape(shape)
    else:
        array["x"] = 0.25
    found = there_and_back(array)
    assert found.dtype == array.dtype and found.shape == shape
    np.testing.assert_array_equal(found, array)


def test_some_fields_of_records():
    """Without what lies between them."""
    records = np.ones(3, dtype=[("x", "<f4"), ("y", "<f8"), ("z", "u1")])[["x", "z"]]
    found = there_and_back(records)
    assert found.dtype == np.dtype([("x", "<f4"), ("z", "u1")]) and found.tolist() == records.tolist()


def test_what_is_there_twice_is_sent_once():
    """Also views: what is sent is contiguous."""
    array = np.arange(12.0).reshape(3, 4).T
    thing = Thing(array, more=array)
    text, arrays = CODEC.encode((thing, thing, array))
    assert len(arrays) == 1
    one, two, again = there_and_back((thing, thing, array))
    assert one is two and one.array is one.more is again
    np.testing.assert_array_equal(again, array)


def test_derived_fields_are_as_they_were(monkeypatch):
    """Nothing is computed or checked again."""
    thing = Thing(np.arange(3.0))
    monkeypatch.setattr(Thing, "__post_init__", lambda self: pytest.fail("made anew"))
    assert there_and_back(thing).total == 3.0


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (Stranger(), "Stranger cannot be sent"),
        (object(), "object cannot be sent"),
        ({1: 2}, "keys must be strings"),
        (np.array([None]), "arrays of object cannot be sent"),
        (np.array(["a"]), "arrays of <U1 cannot be sent"),
    ],
)
def test_unknown_values_are_not_sent(value, told):
    with pytest.raises(CodecError, match=told):
        CODEC.encode((1, value))


def message(**changes):
    """A text of one object with an array of three, changed."""
    return json.dumps(json.loads(CODEC.encode(Thing(np.zeros(3)))[0]) | changes)


THING = {"kind": "Thing", "fields": {"array": {"array": 0}, "more": None, "total": 0.0}}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        message(value={"object": 1}),
        message(value={"array": 1}),
        message(value={"import": "os"}),
        message(value={"object": 0, "array": 0}),
        message(value={"mapping": 3}),
        message(objects=[THING | {"kind": "Stranger"}]),
        message(objects=[THING | {"fields": {"array": {"array": 0}}}]),
        message(objects=[THING | {"fields": THING["fields"] | {"__class__": 1}}]),
        message(objects=[THING | {"fields": THING["fields"] | {"more": {"object": 0}}}]),
    ],
)
def test_what_is_no_message_is_refused(text):
    with pytest.raises(CodecError):
        CODEC.decode(text, [np.zeros(3)])


@pytest.mark.parametrize(
    "arrays",
    [
        [["|O", [3]]],
        [["<f8", [-1]]],
        [["<f8", ["3"]]],
        [["<f8", [1 << 40, 1 << 40]]],
        [["<f8", [1 << 16]], ["<f8", [1 << 16]], ["<f8", [1]]],
        [[[["x", "|O"]], [3]]],
        [["nonsense", [3]]],
        [3],
        3,
    ],
)
def test_arrays_of_a_wrong_kind_or_size_are_not_made(arrays):
    """A bound holds for all arrays together."""
    with pytest.raises(CodecError):
        CODEC.empty_arrays(message(arrays=arrays), 1 << 20)
