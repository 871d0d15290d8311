"""Joint states from their bytes: the same as by way of the message, and nothing that bytes can hold breaks it."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from physkin_ros.joints.joint_map import MappedJoint
from physkin_ros.joints.joint_state_wire import MOST_NAMES, JointStateWire
from physkin_ros.joints.joint_states import JointStateError, JointStateReader, MappedNames

NAMES = ("hip", "knee", "ankle", "neck")
REST = np.array([0.1, 0.2, 0.3, 0.4])


def wire_bytes(names, positions, *, frame="", stamp=(1, 2), order="<", names_count=None) -> bytes:
    """A joint state as CDR, written here from the standard's rules alone."""
    body = struct.pack(f"{order}iI", *stamp)

    def text(word: str) -> None:
        nonlocal body
        body += b"\0" * (-len(body) % 4) + struct.pack(f"{order}I", len(word.encode()) + 1) + word.encode() + b"\0"

    text(frame)
    body += b"\0" * (-len(body) % 4) + struct.pack(f"{order}I", len(names) if names_count is None else names_count)
    for name in names:
        text(name)
    body += b"\0" * (-len(body) % 4) + struct.pack(f"{order}I", len(positions))
    if positions:
        body += b"\0" * (-len(body) % 8) + struct.pack(f"{order}{len(positions)}d", *positions)
    body += struct.pack(f"{order}II", 0, 0)
    return b"\0\0\0\0"[:1] + (b"\1" if order == "<" else b"\0") + b"\0\0" + body


@pytest.fixture
def reader() -> JointStateReader:
    return JointStateReader(NAMES, REST)


@pytest.mark.parametrize("order", "<>")
def test_equals_the_reader(reader, order):
    """Any names, frame and byte order, and each layout a second time, when it is known."""
    out, random = np.empty(4, dtype=np.float32), np.random.default_rng(2)
    wire = JointStateWire(reader, out)
    for _ in range(60):
        count = int(random.integers(1, 5))
        names = [*random.permutation(NAMES)[:count].tolist(), *["tail" * int(random.integers(1, 5))]]
        frame = "f" * int(random.integers(0, 9))
        for _ in range(2):
            values = random.normal(size=len(names)).tolist()
            stamp = (int(random.integers(-(2**31), 2**31)), int(random.integers(0, 2**32)))
            wire.read(wire_bytes(names, values, frame=frame, stamp=stamp, order=order))
            np.testing.assert_array_equal(out, reader.read(names, values))
            assert wire.stamp == stamp


def test_known_names_are_not_looked_at_again(reader):
    """Whatever the stamp and the positions; two publishers may take turns."""
    out = np.empty(4, dtype=np.float32)
    wire = JointStateWire(reader, out)
    looked, select = [], reader.select
    reader.select = lambda names: looked.append(names) or select(names)
    for index in range(6):
        wire.read(wire_bytes(["hip", "knee"], [index, 2.0], stamp=(index, 0)))
        wire.read(wire_bytes(["ankle"], [3.0]))
    assert looked == [("hip", "knee"), ("ankle",)]


def test_padding_says_nothing(reader):
    """Middleware leaves between names whatever was there before: the names are still known."""
    out = np.empty(4, dtype=np.float32)
    wire = JointStateWire(reader, out)
    looked, select = [], reader.select
    reader.select = lambda names: looked.append(names) or select(names)
    good = wire_bytes(["hip", "ankle"], [1.0, 2.0])
    padded = bytearray(good)
    padded[17:20] = b"\1\2\3"  # after the empty frame
    padded[42:44] = b"\4\5"  # after "ankle"
    for data in (good, bytes(padded)):
        wire.read(data)
        np.testing.assert_array_equal(out, np.float32([1, 0.2, 2, 0.4]))
    wire.read(good[:24] + struct.pack("<I", 4) + b"nec" + good[31:])
    assert looked == [("hip", "ankle"), ("nec", "ankle")]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not a joint state: 0 bytes"),
        (b"\1\2\3\4" * 20, "not a joint state: 80 bytes that start with 01 02 03 04"),
        (wire_bytes([], []), "names no joints"),
        (wire_bytes(["hip", "knee"], [1.0]), "2 names but 1 positions"),
        (wire_bytes(["hip", "hip"], [1.0, 2.0]), "are the same joint"),
        (wire_bytes(["hip"], [1.0])[:-12], "cut off"),
        (wire_bytes(["hip"], [1.0], names_count=3), "cut off"),
        (wire_bytes(["hip"], [], names_count=2**32 - 1), f"names {2**32 - 1} joints; at most {MOST_NAMES}"),
        (wire_bytes([f"joint{i}" for i in range(5000)], [0.0] * 5000), "names 5000 joints"),
    ],
)
def test_bad_bytes_are_refused(reader, data, reason):
    """Every time, and a good message is read as ever afterwards."""
    out = np.empty(4, dtype=np.float32)
    wire = JointStateWire(reader, out)
    for _ in range(2):
        with pytest.raises(JointStateError, match=reason):
            wire.read(data)
    wire.read(wire_bytes(["hip"], [5.0]))
    np.testing.assert_array_equal(out, np.float32([5, 0.2, 0.3, 0.4]))


def test_any_cut_and_any_changed_byte(reader):
    """Nothing but JointStateError comes out."""
    good = wire_bytes(["hip", "tail", "knee"], [1.0, 2.0, 3.0], frame="torso")
    out, random = np.empty(4, dtype=np.float32), np.random.default_rng(5)
    wire = JointStateWire(reader, out)
    for trial in range(3000):
        data = bytearray(good[: random.integers(0, len(good))] if trial % 2 else good)
        for at in random.integers(0, max(1, len(data)), size=3 if data else 0):
            data[at] = random.integers(256)
        try:
            wire.read(bytes(data))
        except JointStateError:
            continue
        assert np.isfinite(out).all()


@pytest.mark.parametrize("order", "<>")
def test_positions_that_are_not_ordinary(order):
    """What native code leaves alone is read, counted or refused as by the reader; a map's scale and offset count."""
    doubts = []
    naming = MappedNames(NAMES, {"left": MappedJoint("hip", -2.0, 0.5)})
    reader = JointStateReader(NAMES, REST, naming=naming, on_degrees=lambda *told: doubts.append(told))
    out = np.empty(4, dtype=np.float32)
    wire = JointStateWire(reader, out)
    for value, expected in ((1.0, -1.5), (-45.0, 90.5)):
        wire.read(wire_bytes(["left", "nobody"], [value, 1e300], order=order))
        np.testing.assert_array_equal(out, np.float32([expected, 0.2, 0.3, 0.4]))
    assert doubts == [("left", -45.0)]
    for value in (np.nan, np.inf, -np.inf, 1e39):
        with pytest.raises(JointStateError, match="'left' is .*; it must be finite"):
            wire.read(wire_bytes(["left"], [value], order=order))
    wire.read(wire_bytes(["left", "knee"], [np.nan, 1.0], order=order))
    np.testing.assert_array_equal(out, np.float32([0.1, 1.0, 0.3, 0.4]))
    wire.read(wire_bytes(["neck"], [3.0], order=order))
    np.testing.assert_array_equal(out, np.float32([0.1, 0.2, 0.3, 3.0]))


def test_joints_that_are_not_named_keep_what_the_reader_has(reader):
    """Its positions may be set after the first message of a layout."""
    out = np.empty(4, dtype=np.float32)
    wire = JointStateWire(reader, out)
    wire.read(wire_bytes(["hip"], [1.0]))
    reader.positions = np.float32([5.0, 6.0, 7.0, 8.0])
    wire.read(wire_bytes(["hip"], [2.0]))
    np.testing.assert_array_equal(out, np.float32([2, 6, 7, 8]))
    assert reader.positions[0] == 5.0
    wire.keep()
    wire.read(wire_bytes(["knee"], [3.0]))
    np.testing.assert_array_equal(out, np.float32([2, 3, 7, 8]))


@pytest.mark.parametrize("long", [{"frame": "f" * 300_000}, {"names": ("hip", "n" * 300_000)}])
def test_long_frames_and_names_are_not_read(reader, long):
    """Nor kept, though a good joint is named."""
    wire = JointStateWire(reader, np.empty(4, dtype=np.float32))
    names = long.get("names", ("hip", "tail"))
    with pytest.raises(JointStateError, match="have over 262144 bytes"):
        wire.read(wire_bytes(names, [1.0, 2.0], frame=long.get("frame", "")))
    assert not wire._recent and not reader._selections
