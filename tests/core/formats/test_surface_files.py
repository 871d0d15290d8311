"""PLY and OBJ files that say more than they hold, or what cannot be, are refused."""

from __future__ import annotations

import pytest

from physkin_core.file_reading import ContentError
from physkin_core.formats.obj_file import read_obj
from physkin_core.formats.ply_file import read_ply

XYZ = "property float x\nproperty float y\nproperty float z\n"


def _ply(layout, elements, data=b""):
    return f"ply\nformat {layout} 1.0\n{elements}end_header\n".encode() + data


LITTLE = "binary_little_endian"
ROWS = f"element vertex 3\n{XYZ}"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (_ply("ascii", f"element vertex 1{'0' * 30}\n{XYZ}", b"1 2 3\n"), "with a count, got 'vertex 1000"),
        (_ply("ascii", f"element vertex -3\n{XYZ}", b"1 2 3\n"), "with a count, got 'vertex -3'"),
        (_ply("ascii", f"element vertex 9000000\n{XYZ}", b"1 2 3\n"), "must be 9000000 lines of 3 numbers"),
        (_ply(LITTLE, ROWS + "property float x\n", bytes(48)), "vertices have property 'x' twice"),
        (_ply(LITTLE, ROWS, bytes(35)), "cut off: 1 bytes of its 3 vertices are missing"),
        (b"ply\n" + b"comment \n" * 10_000 + b"end_header\n", "no header from 'ply' to 'end_header' in 65536 bytes"),
    ],
)
def test_ply_headers_are_checked(tmp_path, content, message):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(ContentError, match=message):
        read_ply(tmp_path / "a.ply")


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TRIANGLE + f"f 1 2 {'9' * 5000}\n", r"'9+\.\.\.9+' is no corner"),
        (TRIANGLE + "f 1 2 4\n", "a face has corners at vertices that do not exist; there are 3"),
    ],
)
def test_corners_of_an_obj_are_checked(tmp_path, text, message):
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(ContentError, match=message):
        read_obj(tmp_path / "a.obj")
