"""Network weights in ten bits or eight: what is kept, what the three tensors say, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core.formats.packed_weights import pack_weight, unpack_weights

SHAPES = [(1, 1), (3, 4), (5, 7), (16, 42), (8, 1536)]


def some_weight(shape):
    """Columns of very different size, as inputs of different units have; a row of zeros where there are several."""
    rng = np.random.default_rng(shape)
    weight = rng.normal(size=shape) * np.resize([0.2, 1e-3, 30.0, 1.0], shape[1])
    weight[1:2] = 0
    return weight.astype(np.float32)


@pytest.mark.parametrize("shape", SHAPES)
def test_weights_are_kept_to_half_a_step(shape):
    """Of 511 to the largest of the row's columns that are a multiple of four apart. Packed again, not a bit differs."""
    weight = some_weight(shape)
    tensors = pack_weight("a.weight", weight)
    (name, back), *others = unpack_weights(tensors).items()
    assert name == "a.weight" and back.dtype == np.float32 and back.flags.c_contiguous and not others
    for k in range(min(4, shape[1])):
        columns = slice(k, None, 4)
        step = np.abs(weight[:, columns]).max(axis=1, keepdims=True) / 511
        assert (np.abs(back - weight)[:, columns] <= 0.501 * step).all()
    for key, again in pack_weight("a.weight", back).items():
        np.testing.assert_array_equal(again, tensors[key], err_msg=key, strict=True)


@pytest.mark.parametrize("shape", SHAPES[1:])
def test_the_three_tensors_are_what_the_format_says(shape):
    """Read number by number; their bytes are five eighths of half precision's, but for the scales and the last byte."""
    tensors = pack_weight("a.weight", some_weight(shape))
    high, low, largest = (tensors[name] for name in ("a.weight", "a.weight.low", "a.weight.largest"))
    back = unpack_weights(tensors)["a.weight"]
    for (i, j), value in np.ndenumerate(back):
        steps = 4 * int(high[i, j]) + (int(low[i, j // 4]) >> 2 * (j % 4)) % 4
        assert abs(steps) <= 511 and value == pytest.approx(float(largest[i, j % 4]) * steps / 511, rel=1e-6)
    assert high.nbytes + low.nbytes + largest.nbytes <= (1.25 * shape[1] + 0.75 + 8) * shape[0]


def weight_on_steps():
    """Rows on 127 steps to their largest, but for what half precision does to it."""
    rng = np.random.default_rng(7)
    steps = rng.integers(-127, 128, size=(6, 40))
    steps[:, 0], steps[1] = 127, 0
    return (steps * rng.uniform(0.1, 3.0, size=(6, 1)) / 127).astype(np.float32), steps


def test_what_lies_on_steps_takes_eight_bits_and_keeps_them():
    weight, steps = weight_on_steps()
    tensors = pack_weight("a.weight", weight)
    assert tensors.keys() == {"a.weight", "a.weight.largest_127"}
    np.testing.assert_array_equal(tensors["a.weight"], steps)
    (name, back), *others = unpack_weights(tensors).items()
    assert name == "a.weight" and back.dtype == np.float32 and not others
    np.testing.assert_allclose(back, weight, rtol=5e-4)
    for key, again in pack_weight("a.weight", back).items():
        np.testing.assert_array_equal(again, tensors[key], err_msg=key, strict=True)


@pytest.mark.parametrize("every", [2, 3, 8, 40])
def test_of_steps_that_leave_some_out_only_how_often_is_stored(every):
    """The largest, 127, need not be among them; every row has its own."""
    weight, steps = weight_on_steps()
    steps = steps - np.fmod(steps, every)
    steps[:, 0], steps[1] = -127, 0
    steps[2, 1:] = 1
    largest = np.abs(weight).max(axis=1, keepdims=True)
    weight = (steps * largest / 127).astype(np.float32)
    tensors = pack_weight("a.weight", weight)
    assert tensors["a.weight.every"].dtype == np.uint8
    assert (tensors["a.weight.every"][[0, 3, 4, 5]] % every == 0).all() and (tensors["a.weight.every"][1:3] == 1).all()
    assert np.abs(tensors["a.weight"][3:]).max() <= 127 // every + 1
    back = unpack_weights(tensors)
    np.testing.assert_array_equal(
        back["a.weight"],
        unpack_weights({"a.weight": steps.astype(np.int8), "a.weight.largest_127": tensors["a.weight.largest_127"]})[
            "a.weight"
        ],
    )
    assert back.keys() == {"a.weight"}
    for key, again in pack_weight("a.weight", back["a.weight"]).items():
        np.testing.assert_array_equal(again, tensors[key], err_msg=key, strict=True)


def test_one_weight_between_two_steps_makes_it_ten_bits():
    weight, _ = weight_on_steps()
    weight[3, 5] = 0.4 / 127 * weight[3, 0]
    assert "a.weight.low" in pack_weight("a.weight", weight)


def test_other_tensors_are_left_alone():
    tensors = {"a.weight": np.ones((4, 4), np.float16), "a.bias": np.ones(4, np.int8), "faces": np.ones(3, np.uint8)}
    unpacked = unpack_weights(tensors)
    assert unpacked.keys() == tensors.keys() and all(unpacked[name] is tensors[name] for name in tensors)


def in_eight_bits():
    _, steps = weight_on_steps()
    steps[:, 1:] -= np.fmod(steps[:, 1:], 4)
    return pack_weight("a.weight", (steps / 127).astype(np.float32))


TEN, EIGHT = pack_weight("a.weight", some_weight((5, 7))), in_eight_bits()


@pytest.mark.parametrize(
    "tensors, part, change, message",
    [
        (TEN, "", lambda high: high[0], r"a.weight has shape \(7,\), expected two dimensions"),
        (TEN, "", lambda high: high[1:], r"low is uint8 of shape \(5, 2\), expected uint8 of shape \(4, 2\)"),
        (TEN, ".low", lambda low: low[:, 1:], r"low is uint8 of shape \(5, 1\), expected uint8 of shape \(5, 2\)"),
        (TEN, ".low", lambda low: low.astype(np.int8), r"low is int8 of shape .*, expected uint8"),
        (TEN, ".low", None, "a.weight.low"),
        (TEN, ".largest", lambda largest: largest[:, 0], r"largest is float16 of shape \(5,\), expected .* \(5, 4\)"),
        (TEN, ".largest", lambda largest: largest.astype(np.float32), "largest is float32 .*, expected float16"),
        (TEN, ".largest", lambda largest: -largest, "largest holds -.*, allowed: a finite number, 0 or more"),
        (TEN, ".largest", lambda largest: largest * np.float16("nan"), "largest holds nan, allowed: a finite"),
        (TEN, ".largest", lambda largest: np.full_like(largest, np.inf), "largest holds inf, allowed: a finite"),
        (TEN, ".largest", None, "a.weight.largest"),
        (EIGHT, ".largest_127", lambda largest: -largest, "largest_127 holds -.*, allowed: a finite number, 0 or more"),
        (EIGHT, ".largest_127", lambda largest: largest[:, 0], r"largest_127 is .*\(6,\), expected .* \(6, 1\)"),
        (EIGHT, ".every", lambda every: every[:, 0], r"every is .* of shape .*, expected uint8 of shape \(6, 1\)"),
        (EIGHT, ".every", lambda every: every.astype(np.int8), r"every is int8 .*, expected uint8 of shape \(6, 1\)"),
    ],
)
def test_damaged_and_missing_tensors_are_refused(tensors, part, change, message):
    """change: None takes the tensor out."""
    changed = dict(tensors)
    tensor = changed.pop(f"a.weight{part}")
    if change is not None:
        changed[f"a.weight{part}"] = change(tensor)
    with pytest.raises((ValueError, KeyError), match=message):
        unpack_weights(changed)
