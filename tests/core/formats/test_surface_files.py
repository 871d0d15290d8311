"""PLY, STL, OFF and OBJ files that would take memory or time out of all proportion are refused before they do."""

from __future__ import annotations

import time

import numpy as np
import pytest
import trimesh

from physkin_core.file_reading import ContentError
from physkin_core.formats import mesh_limits, surface_file
from physkin_core.formats.obj_file import read_obj
from physkin_core.formats.ply_file import read_ply
from physkin_core.formats.surface_file import read_surface

XYZ = "property float x\nproperty float y\nproperty float z\n"


def _ply(layout, elements, data=b""):
    return f"ply\nformat {layout} 1.0\n{elements}end_header\n".encode() + data


LITTLE = "binary_little_endian"
ROWS = f"element vertex 3\n{XYZ}"
LONG_WORD = b"1 2 3\n" * 2 + b"1 2 " + b"0" * (1 << 20) + b"\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (_ply("ascii", ROWS, LONG_WORD), "3 lines of 3 numbers of at most 100 characters"),
        (_ply("ascii", f"element vertex 1{'0' * 30}\n{XYZ}", b"1 2 3\n"), "must have a count, got '1000"),
        (_ply("ascii", f"element vertex 9000000\n{XYZ}", b"1 2 3\n"), "it is cut off, at least 8999994 bytes"),
        (_ply(LITTLE, ROWS + "property float x\n", bytes(48)), "its 'vertex' have property 'x' twice"),
        (_ply(LITTLE, ROWS + "element empty 99999999999\n", bytes(36)), "element 'empty' has no properties"),
        (_ply(LITTLE, ROWS + "element face -3\nproperty list uchar int i\n", bytes(36)), "'face' must have a count"),
        (_ply(LITTLE, ROWS, bytes(35)), r"cut off, at least 1 bytes of its rows \(3 'vertex'\)"),
        (b"ply\n" + b"comment \n" * 10_000 + b"end_header\n", "no header from 'ply' to 'end_header' in 65536 bytes"),
    ],
)
def test_ply_headers_are_checked(tmp_path, content, message):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(ContentError, match=message):
        read_ply(tmp_path / "a.ply")


def test_surfaces_of_ply_are_checked_first(tmp_path):
    """By the same header; trimesh would take the last of two properties of a name."""
    (tmp_path / "a.ply").write_bytes(_ply(LITTLE, ROWS + "property float x\n", bytes(48)))
    with pytest.raises(ContentError, match="have property 'x' twice"):
        read_surface(tmp_path / "a.ply")
    mesh = trimesh.creation.icosphere(subdivisions=1)
    for encoding in ("ascii", "binary"):
        mesh.export(tmp_path / "b.ply", encoding=encoding)
        vertices, faces = read_surface(tmp_path / "b.ply")
        np.testing.assert_allclose(vertices, mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(faces, mesh.faces)


@pytest.mark.parametrize("suffix", ["ply", "stl", "off"])
def test_surfaces_have_limits(tmp_path, monkeypatch, suffix):
    """Of faces, of bytes and of lines."""
    path = tmp_path / f"a.{suffix}"
    trimesh.creation.icosphere(subdivisions=2).export(path)
    assert len(read_surface(path)[1]) == 320
    monkeypatch.setattr(mesh_limits, "MOST_FACES", 319)
    with pytest.raises(ContentError, match="it has 320 faces or more, allowed are 319; simplify the mesh"):
        read_surface(path)
    monkeypatch.undo()
    if suffix == "off":
        monkeypatch.setattr(surface_file, "MOST_LINES", 300)
        with pytest.raises(ContentError, match="it has [0-9]+ lines, allowed are 300"):
            read_surface(path)
        monkeypatch.setattr(surface_file, "LARGEST_TEXT", 1_000)
        with pytest.raises(ContentError, match="bytes of text, allowed are 1000; save it as binary"):
            read_surface(path)


def test_solids_of_an_stl_are_counted(tmp_path):
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    (tmp_path / "a.stl").write_text(f"solid\nfacet normal 0 0 1\n{corners}endsolid\n" * 10_001)
    with pytest.raises(ContentError, match="it has 10001 parts or more, allowed are 10000"):
        read_surface(tmp_path / "a.stl")


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TRIANGLE + "".join(f"o p{k}\nf 1 2 3\n" for k in range(60_000)), "it has 10001 parts or more"),
        (TRIANGLE + "f" + " 1" * 600_000, "a line of 1200001 characters, allowed are 1048576"),
        (TRIANGLE + "f" + " 1 \\\n" * 300_000, "a line of .* characters"),
        (TRIANGLE + f"f 1 2 {10**30}\n", "'f 1 2 1000.*' refers to vertices or texture coordinates that do not exist"),
        (TRIANGLE + f"f 1 2 {'9' * 5000}\n", r"'9+\.\.\.9+' is no corner"),
        (TRIANGLE + "f 1 2 4\n", "a face has corners at vertices that do not exist; there are 3"),
        ("\f" * 8_000_001, "it has 8000001 lines, allowed are 8000000"),
    ],
)
@pytest.mark.timeout(60)
def test_obj_files_have_limits(tmp_path, text, message):
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(ContentError, match=message):
        read_obj(tmp_path / "a.obj")


def test_faces_of_an_obj_are_counted_before_they_are_cut(tmp_path, monkeypatch):
    monkeypatch.setattr(mesh_limits, "MOST_FACES", 100)
    (tmp_path / "a.obj").write_text(TRIANGLE + "f" + " 1" * 200 + "\n")
    with pytest.raises(ContentError, match="it has 198 faces or more, allowed are 100"):
        read_obj(tmp_path / "a.obj")


def test_parts_of_an_obj_take_linear_time(tmp_path):
    """Each with a name of its own, as many as are allowed."""
    (tmp_path / "a.obj").write_text(TRIANGLE + "".join(f"o p{k}\nusemtl m{k}\nf 1 2 3\n" for k in range(10_000)))
    began = time.process_time()
    assert len(read_obj(tmp_path / "a.obj").names) == 10_000
    assert time.process_time() - began < 5
