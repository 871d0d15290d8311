"""BVH files as tools write them mean the same as the plain one; what is none is refused by its line."""

from __future__ import annotations

import re

import numpy as np
import pytest
from bvh_clips import JOINTS, POSE, write_bvh

from physkin_core import MotionError, load_body_model
from physkin_core.file_reading import ContentError, read_text
from physkin_core.motion.bvh_file import read_bvh
from physkin_core.motion.clip_files import load_clip as load_mocap


@pytest.fixture(scope="module")
def rig():
    return load_body_model().rig


def compact(text):
    """The tree on one line."""
    head, mark, data = text.partition("MOTION")
    return " ".join(head.split()) + "\n" + mark + data


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("End Site", "END SITE").replace("OFFSET", "Offset").replace("CHANNELS", "channels"),
        lambda text: text.replace("MOTION", "motion").replace("Frames", "FRAMES").replace("Frame Time", "frame time"),
        lambda text: text.replace("rotation", "Rotation").replace("position", "POSITION").replace("JOINT", "Joint"),
        lambda text: text.replace("Frames:", "Frames").replace("Frame Time:", "FrameTime ="),
        lambda text: text.replace(" ", "\t"),
        lambda text: text.replace("\n", "\r\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace(" ", "\xa0"),
        lambda text: text.replace("\n{", " {").replace("\n}", " }"),
        compact,
        lambda text: "# by hand\n\n" + text.replace("MOTION", "// frames\nMOTION").replace("{", "{  # begins", 3),
        lambda text: text.replace("CHANNELS 3", "CHANNELS 6"),
        lambda text: text.replace(".", ","),
        lambda text: text.replace("Frame Time", "Frame_time").replace(" -", ", -"),
        lambda text: text + "\0" * 100,
    ],
)
def test_text_as_tools_write_it(change, rig, tmp_path):
    """Keywords in any case, other blanks and line ends, braces and keywords on one line, remarks, commas."""
    path = write_bvh(tmp_path / "a.bvh", [{**POSE, "position": (0, 95.5, 0)}] * 2)
    plain = load_mocap(path, rig)[0]
    path.write_bytes(change(path.read_text()).encode())
    np.testing.assert_array_equal(load_mocap(path, rig)[0].positions, plain.positions)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "shift-jis", "latin-1"])
def test_encodings(encoding, rig, tmp_path):
    """Names of other alphabets are read, and the rest as ever."""
    name = "Spiné" if encoding == "latin-1" else "背骨ボーン"
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 2)
    plain, text = load_mocap(path, rig)[0], path.read_text()
    path.write_bytes(text.replace("JOINT Spine1", f"JOINT {name}").encode(encoding))
    np.testing.assert_array_equal(load_mocap(path, rig)[0].positions, plain.positions)
    assert read_bvh(read_text(path)).names[1] == name


@pytest.mark.parametrize("offsets", ["equal", "zero", "of another unit", "to which positions are added"])
def test_joints_with_positions(offsets, rig, tmp_path):
    """Whatever the offsets are: the bones are as long as the positions make them, and hands end in the same place."""
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 2)
    plain, text = load_mocap(path, rig)[0], path.read_text()
    given = {name: np.array(offset, dtype=float) for name, _, offset in JOINTS}
    scale = {"zero": 0.0, "of another unit": 0.01}.get(offsets, 1.0)
    text = re.sub(
        r"OFFSET (.*)\n", lambda line: f"OFFSET {' '.join(str(scale * float(v)) for v in line[1].split())}\n", text
    )
    text = text.replace("CHANNELS 3 ", "CHANNELS 6 Yposition Xposition Zposition ")
    head, *rows = text.rstrip().rsplit("\n", 2)
    names = re.findall("(?:ROOT|JOINT) (.*)", head)
    moved = []
    for row in rows:
        values = row.split()
        out = values[:6]
        for k, name in enumerate(names[1:]):
            place = np.zeros(3) if "added" in offsets else given[name][[1, 0, 2]]
            out += [*map(str, place), *values[6 + 3 * k : 9 + 3 * k]]
        moved.append(" ".join(out))
    path.write_text("\n".join([head, *moved]) + "\n")
    np.testing.assert_allclose(load_mocap(path, rig)[0].positions, plain.positions, atol=1e-5)


def test_hostile_lines_take_no_time():
    """Long ones, of words that go on or lead nowhere."""
    tree = "ROOT a\n{\nCHANNELS 1 Xrotation\n}\nMOTION\n"
    for text in (
        "HIERARCHY " * 10**5,
        "ROOT a " + "{ " * 10**5,
        tree + "frames" + " " * 10**5,
        tree + "frame" + " " * 10**5,
    ):
        with pytest.raises(ContentError):
            read_bvh(text)


def test_any_number_of_frames_is_taken(rig, tmp_path, caplog):
    """What a file says is one warning; what it has is what comes."""
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 3)
    text, plain = path.read_text(), load_mocap(path, rig)[0]
    for said, shown in (("-1", "'-1'"), ("2", "'2'"), ("4", "'4'"), ("", "'no'")):
        caplog.clear()
        path.write_text(text.replace("Frames: 3\n", f"Frames: {said}\n" if said else ""))
        np.testing.assert_array_equal(load_mocap(path, rig)[0].positions, plain.positions)
        assert [record.message for record in caplog.records] == [
            f"{path}: it says that it has {shown} frames; the 3 that it has are taken"
        ]


def test_equal_names_and_names_with_spaces(rig, tmp_path):
    """A name is the rest of its line; joints are told apart by their place in the tree."""
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 2)
    plain, text = load_mocap(path, rig)[0], path.read_text()
    spaced = re.sub("(Left|Right)([A-Z][a-z]*)", r"Bip001 \1 \2", text.replace("Spine1", "Hips"))
    path.write_text(spaced)
    assert set(read_bvh(spaced).names[:2]) == {"Hips"}
    np.testing.assert_array_equal(load_mocap(path, rig)[0].positions, plain.positions)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            lambda text: text.replace("LeftForeArm", "Neck"),
            "no joint for 3 of the 12 rig bones it must have: upperarm01.L, .*not recognised: .*'LeftArm'",
        ),
        (
            lambda text: text.replace("Frame Time: ", "Frame Time: s"),
            "SECONDS' must follow MOTION, got 's0",
        ),
        (lambda text: text.replace("Frame Time", "Time"), "line 99 has 'Time:'; allowed are 48 finite numbers"),
        (
            lambda text: text.rstrip()[:-4],
            "line 101 has 46 values; allowed are 48 finite numbers",
        ),
        (lambda text: text + "0 " * 48 + "0\n0", "line 102 has 49 values"),
        (lambda text: text.replace(" 95 ", " nan "), "line 100 has 'nan'; allowed are 48 finite numbers"),
        (
            lambda text: text.replace("OFFSET 0 20 0", "OFFSET 0 20"),
            "line 8 has 2 values; allowed are 3 finite numbers",
        ),
        (lambda text: text.replace("OFFSET 0 20 0", "OFFSET 0 x 0"), "line 8 has 'x'; allowed are 3 finite numbers"),
        (lambda text: text.replace("OFFSET 0 20", "OFSET 0 20"), "line 8: 'OFSET' cannot stand within 2 open braces"),
        (lambda text: text.replace("Zrot", "Wrot", 1), "line 5: 'Wrotation' cannot stand within 1 open"),
        (lambda text: text.replace("Zrot", "Xrot", 1), "line 5: joint 'Hips' has channel Xrotation twice"),
        (lambda text: text.replace("}", "", 1), "line 97: 'MOTION' cannot stand within 1 open braces"),
        (
            lambda text: text.replace("MOTION", "}\nMOTION"),
            "line 97: '}' cannot stand within 0 open braces; allowed are ROOT, JOINT",
        ),
        (lambda text: text.replace("Spine1", "Spi\0ne1"), "line 6 has a zero byte"),
        (
            lambda text: text.replace("Frame Time: 0.016666666666666666\n", ""),
            "'Frame Time: SECONDS' must .* got 'none'",
        ),
        (lambda text: text.partition("Frames")[0] + "Frame Time: 1", "no frames after its frame time"),
        (
            lambda text: text.replace("Frame Time: ", "Frame Time: 3600"),
            "time is 36000 s, allowed are 1e-05 to 10 s",
        ),
        (lambda text: text.replace("Frame Time: ", "Frame Time: nan #"), "time is nan s"),
        (lambda text: text.replace("JOINT", "JOINT a\n" * 1000 + "JOINT", 1), "line 1005: it has over 1000 joints"),
        (lambda text: "", "no line MOTION"),
        (lambda text: text.partition("MOTION")[0], "no line MOTION"),
    ],
)
def test_broken_files_are_refused(change, reason, rig, tmp_path):
    """The file is named, and what is wrong with it."""
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 2)
    path.write_text(change(path.read_text()))
    with pytest.raises(MotionError, match=f"a.bvh.*({reason})"):
        load_mocap(path, rig)
