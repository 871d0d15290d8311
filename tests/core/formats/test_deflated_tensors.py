"""Tensors deflated: every number comes back, in fewer bytes, and streams that lie about themselves are refused."""

from __future__ import annotations

import json
import tracemalloc
import zlib

import numpy as np
import pytest

from physkin_core.file_reading import ContentError
from physkin_core.formats.deflated_tensors import (
    DEFLATED,
    LEAST_DEFLATED,
    deflate_tensors,
    inflate_tensors,
)


def some_tensors():
    rng = np.random.default_rng(7)
    strip = np.arange(900)[:, None] + [0, 1, 2]
    return {
        "weight": np.rint(8 * rng.normal(size=(64, 48))).astype(np.int8),
        "bias": rng.normal(size=600).astype(np.float16),
        "places": np.cumsum(rng.integers(-300, 300, size=(700, 3)), axis=0).astype(np.int32),
        "faces": strip.astype(np.uint16),
        "noise": rng.integers(0, 256, size=4000).astype(np.uint8),
        "zeros": np.zeros((40, 50), np.uint32),
        "small": np.zeros(LEAST_DEFLATED - 1, np.uint8),
        "wide": np.zeros(1000),
    }


def test_every_bit_comes_back_in_fewer_bytes():
    """Noise, small tensors and types that files do not hold are stored as they are."""
    tensors = some_tensors()
    metadata, stored = deflate_tensors(tensors)
    for name in ("noise", "small", "wide"):
        assert stored[name] is tensors[name]
    for name, most in {"weight": 0.66, "bias": 0.99, "places": 0.45, "faces": 0.05, "zeros": 0.01}.items():
        assert stored[name].nbytes < most * tensors[name].nbytes, name
    plain, back = inflate_tensors({"name": "a", **metadata}, stored)
    assert plain == {"name": "a"} and back.keys() == tensors.keys()
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(back[name], tensor, err_msg=name, strict=True)


def test_weights_on_few_steps_take_about_their_entropy():
    weight = np.rint(4 * np.random.default_rng(1).normal(size=(300, 300))).astype(np.int8)
    shares = np.unique(weight, return_counts=True)[1] / weight.size
    entropy = -(shares * np.log2(shares)).sum()
    assert 8 * deflate_tensors({"w": weight})[1]["w"].nbytes / weight.size < entropy + 0.1


def test_indices_that_fall_and_rise_wrap_around_and_come_back():
    tensors = {"faces": np.tile([[65535, 0, 7], [0, 65535, 3]], (200, 1)).astype(np.uint16)}
    assert inflate_tensors({}, tensors)[1]["faces"] is tensors["faces"]
    np.testing.assert_array_equal(inflate_tensors(*deflate_tensors(tensors))[1]["faces"], tensors["faces"], strict=True)


def raw(content: bytes) -> np.ndarray:
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    return np.frombuffer(deflate.compress(content) + deflate.flush(), np.uint8)


SOUND = raw(bytes(1000))


PLAIN = ["|u1", [1000], "plain"]


@pytest.mark.parametrize(
    "entry, stream, message",
    [
        *((entry, SOUND, "TypeError|KeyError|ValueError") for entry in (
            7, [], ["|u1"], ["|u1", 1000, "plain"], ["|u1", [], "plain"], ["<f8", [125], "plain"],
            ["|O", [125], "plain"], [3, [1000], "plain"], ["|u1", [-1000], "plain"], ["|u1", [1000.0], "plain"])),
        *(([dtype, [1000], kind], SOUND, "allowed are uint8 and plain, rows, numbers")
          for dtype, kind in (("|u1", "columns"), ("|u1", 0), ("<f2", "rows"))),
        *((["|u1", [size], "plain"], SOUND, f"does not inflate to {size} bytes") for size in (0, 999, 1001)),
        (PLAIN, SOUND[:-1], "does not inflate to"),
        (PLAIN, np.append(SOUND, SOUND[:1]), "does not inflate to"),
        (PLAIN, SOUND[:0], "0 bytes cannot hold 1000"),
        (PLAIN, SOUND[::-1].copy(), "while decompressing|does not inflate"),
        (PLAIN, SOUND.astype(np.int16), "allowed are uint8 and"),
        (["<u4", [1 << 20] * 3, "plain"], SOUND, "11 bytes cannot hold 4611686018427387904"),
        (["|u1", [10**400], "plain"], SOUND, "11 bytes cannot hold an integer of 1329 bits"),
    ],
)  # fmt: skip
def test_what_lies_about_itself_is_refused(entry, stream, message):
    with pytest.raises(ContentError, match=rf"'a' cannot be inflated by .type, shape, kind. .*({message})"):
        inflate_tensors({DEFLATED: json.dumps({"a": entry})}, {"a": stream})


@pytest.mark.parametrize(
    "text, message",
    [("{", "is no JSON object"), ("[" * 100_000, "is no JSON object"), ("[1]", "no JSON object"), ('{"b": 1}', "'b'")],
)
def test_entries_of_something_else_are_refused(text, message):
    with pytest.raises(ContentError, match=message):
        inflate_tensors({DEFLATED: text}, {"a": SOUND})


def test_a_stream_of_many_megabytes_takes_no_more_than_it_says():
    """A few bytes inflate to 64 megabytes; it is left at what the metadata say."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    chunk = bytes(1 << 20)
    bomb = b"".join(deflate.compress(chunk) for _ in range(64)) + deflate.flush()
    tracemalloc.start()
    try:
        with pytest.raises(ContentError, match="does not inflate to 1000 bytes"):
            inflate_tensors(
                {DEFLATED: json.dumps({"a": ["|u1", [1000], "plain"]})}, {"a": np.frombuffer(bomb, np.uint8)}
            )
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()
