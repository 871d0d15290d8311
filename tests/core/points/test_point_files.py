"""Files of points: what is moved, and that all else stays."""

import numpy as np
import pytest
import trimesh
from core.points.splat_files import FIELDS, splat_ply, splat_table
from PIL import Image
from scipy.spatial import cKDTree

from physkin_core.formats.ply_file import read_ply
from physkin_core.points.point_files import read_points

OBJ = """mtllib cloth.mtl
o shirt
v 0 0 0 0.5 0.25 1
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vn 0 0 1
usemtl red
f 1/1/1 2/2/1 3/2/1 4/1/1 # a quad
f 1//1 2//1 3//1
l 1 2
"""


@pytest.mark.parametrize("layout", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_splats_keep_all_other_properties(layout, tmp_path):
    """Colours, opacity, comments and what comes after the vertices, to the byte; and splats as they are written."""
    path, out = tmp_path / "in.ply", tmp_path / "out.ply"
    path.write_bytes(splat_ply(layout, tail=b"5 4 3\n"))
    file = read_points(path)
    table = splat_table()
    np.testing.assert_allclose(file.splats.scales, np.exp(table[:, FIELDS.index("scale_0") :][:, :3]), rtol=1e-5)
    w = FIELDS.index("rot_0")
    order = [w + 1, w + 2, w + 3, w]
    np.testing.assert_allclose(file.splats.rotations, table[:, order], atol=1e-5)
    look = [name for name in FIELDS if not name.startswith(("x", "y", "z", "rot", "scale"))]
    assert list(file.look.dtype.names) == look
    np.testing.assert_allclose(file.look["opacity"], table[:, FIELDS.index("opacity")], rtol=1e-6)
    moved = file.splats.transformed(np.diag([2.0, 2.0, 2.0]))
    file.write_splats(out, moved)
    again = read_points(out)
    np.testing.assert_allclose(again.points, 2 * file.points, rtol=1e-6)
    np.testing.assert_allclose(again.splats.scales, 2 * file.splats.scales, rtol=1e-5)
    back = tmp_path / "back.ply"
    again.write_splats(back, again.splats.transformed(np.eye(3) / 2))
    header = path.read_bytes().index(b"end_header")
    assert out.read_bytes()[:header] == path.read_bytes()[:header] and out.read_bytes().endswith(b"5 4 3\n")
    kept = tuple(name for name in FIELDS if name.startswith(("n", "f_", "opacity")))
    one, other = (read_ply(place).columns(kept) for place in (path, back))
    np.testing.assert_array_equal(one, other)


def test_trimesh_reads_what_is_written(tmp_path):
    """Colours and faces of a mesh as they were, vertices and normals moved."""
    mesh = trimesh.creation.icosphere(subdivisions=1)
    mesh.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, size=(len(mesh.vertices), 4), dtype=np.uint8)
    for encoding in ("binary", "ascii"):
        path, out = tmp_path / f"{encoding}.ply", tmp_path / f"{encoding}_out.ply"
        mesh.export(path, encoding=encoding, vertex_normal=True)
        file = read_points(path)
        file.write(out, file.points[:, [1, 2, 0]], file.normals[:, [1, 2, 0]])
        again = trimesh.load_mesh(out, process=False)
        np.testing.assert_allclose(again.vertices, mesh.vertices[:, [1, 2, 0]], atol=1e-6)
        np.testing.assert_allclose(again.vertex_normals, mesh.vertex_normals[:, [1, 2, 0]], atol=1e-6)
        np.testing.assert_array_equal(again.faces, mesh.faces)
        np.testing.assert_array_equal(again.visual.vertex_colors, mesh.visual.vertex_colors)


def test_obj_keeps_its_look(tmp_path):
    """UVs, materials, names, quads and colours; normals are left to the reader."""
    path, out = tmp_path / "in.obj", tmp_path / "out.obj"
    path.write_text(OBJ)
    file = read_points(path)
    np.testing.assert_array_equal(file.points, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    file.write(out, file.points + [0, 0, 0.5], None)
    expected = OBJ.replace("v 0 0 0 ", "v 0 0 0.5 ").replace("v 1 0 0\n", "v 1 0 0.5\n").replace("v 1 1 0", "v 1 1 0.5")
    expected = expected.replace("v 0 1 0", "v 0 1 0.5").replace("vn 0 0 1\n", "").replace("1//1 2//1 3//1", "1 2 3")
    assert out.read_text() == expected.replace("1/1/1 2/2/1 3/2/1 4/1/1 # a quad", "1/1 2/2 3/2 4/1")


def test_glb_keeps_its_look(tmp_path):
    """UVs and the picture on it; two meshes, each where the scene has it."""
    sphere, box = trimesh.creation.icosphere(subdivisions=1), trimesh.creation.box()
    uv = np.random.default_rng(0).uniform(size=(len(sphere.vertices), 2))
    picture = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    sphere.visual = trimesh.visual.TextureVisuals(
        uv=uv, material=trimesh.visual.material.PBRMaterial(name="red", baseColorTexture=picture)
    )
    scene = trimesh.Scene()
    scene.add_geometry(sphere, transform=trimesh.transformations.translation_matrix([0, 3, 0]))
    scene.add_geometry(box)
    path, out = tmp_path / "in.glb", tmp_path / "out.glb"
    scene.export(path)
    file = read_points(path)
    assert file.up == "Y" and len(file.points) == len(sphere.vertices) + len(box.vertices)
    file.write(out, 2 * file.points, file.normals[:, [1, 2, 0]])
    found, boxed = sorted(trimesh.load_scene(out, process=False).dump(), key=lambda mesh: -len(mesh.vertices))
    np.testing.assert_allclose(found.vertices, 2 * (sphere.vertices + [0, 3, 0]), atol=1e-6)
    np.testing.assert_allclose(boxed.vertices, 2 * box.vertices, atol=1e-6)
    again = read_points(out)
    _, place = cKDTree(again.points).query(2 * file.points)  # meshes may come in another order
    np.testing.assert_allclose(again.normals[place], file.normals[:, [1, 2, 0]], atol=1e-6)
    np.testing.assert_allclose(found.visual.uv, uv, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(found.visual.material.baseColorTexture), np.asarray(picture))
    np.testing.assert_array_equal(found.faces, sphere.faces)


XYZ, LITTLE = "property float x\nproperty float y\nproperty float z\n", "binary_little_endian"


def ply(layout, elements, data):
    return f"ply\nformat {layout} 1.0\n{elements}end_header\n".encode() + data


def replaced(**words):
    content = splat_ply("binary_little_endian")
    for old, new in words.values():
        content = content.replace(old, new)
    return content


def test_numbers_as_text_may_be_long(tmp_path):
    (tmp_path / "a.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty float y\nproperty float z\n"
        b"property uchar red\nend_header\n0.12345678901234567890123456789012345678e-3 2 3 255\n-1 .5 1e2 7"
    )
    file = read_points(tmp_path / "a.ply")
    np.testing.assert_allclose(file.points, [[0.12345678901234568e-3, 2, 3], [-1, 0.5, 100]], rtol=1e-15)
    file.write(tmp_path / "b.ply", file.points[::-1], None)
    assert (tmp_path / "b.ply").read_bytes().endswith(b"\n-1 0.5 100 255\n0.00012345678901234567 2 3 7\n")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.splat", b"", r"allowed are \.ply, \.obj, \.glb"),
        ("a.ply", None, "no such file"),
        ("a.ply", b"solid", "it is not a PLY file"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header", "it is not a PLY file"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "'vertex' with a count, got 'none'"),
        ("a.ply", replaced(a=(b"binary_little_endian", b"middle")), "its format is 'middle', allowed: ascii"),
        ("a.ply", replaced(a=(b"element vertex", b"element chunk")), "with a count, got 'chunk 40'"),
        ("a.ply", replaced(a=(b"float opacity", b"half opacity")), "'opacity' of its vertices must be one number"),
        ("a.ply", replaced(a=(b"float x", b"list uchar float x")), "property 'x' of its vertices must be one number"),
        ("a.ply", replaced(a=(b"float z", b"int z")), "must have a property 'z' of floating point"),
        ("a.ply", splat_ply("binary_little_endian")[:-10], "cut off: 10 bytes of its 40 vertices are missing"),
        ("a.ply", splat_ply("ascii").replace(b"\n0.", b"\nzero.", 1), "its vertices must be 40 lines of 20 numbers"),
        ("a.ply", splat_ply("ascii")[:-60], "its vertices must be 40 lines of 20 numbers"),
        ("a.ply", splat_ply("ascii", scale=np.nan), "splat 0: its scales must be finite"),
        ("a.ply", splat_ply("ascii", count=0), "its 0 points must be at least one, and finite"),
        ("a.ply", ply("ascii", f"element vertex 1{'0' * 30}\n{XYZ}", b"1 2 3\n"), "with a count, got 'vertex 1000"),
        ("a.ply", ply("ascii", f"element vertex -3\n{XYZ}", b"1 2 3\n"), "with a count, got 'vertex -3'"),
        ("a.ply", ply("ascii", f"element vertex 9000000\n{XYZ}", b"1 2 3\n"), "must be 9000000 lines of 3 numbers"),
        ("a.ply", ply(LITTLE, f"element vertex 3\n{XYZ}property float x\n", bytes(48)), "have property 'x' twice"),
        ("a.ply", ply(LITTLE, f"element vertex 3\n{XYZ}", bytes(35)), "cut off: 1 bytes of its 3 vertices are missing"),
        ("a.ply", b"ply\n" + b"comment \n" * 10_000 + b"end_header\n", "no header from 'ply' to 'end_header' in 65536"),
        ("a.obj", b"v 0 0 0\nf 1 1 " + b"9" * 5000, r"'9+\.\.\.9+' is no corner"),
        ("a.obj", b"v 0 0 0\nf 1 1 2\n", "a face has corners at vertices that do not exist; there are 1"),
        ("a.obj", b"v 0 0\nf 1 1 1\n", "points file .*a.obj: 'v 0 0' must have 3 numbers"),
        ("a.obj", b"# none\n", "its 0 points must be at least one"),
        ("a.obj", b"v 0 0 inf\n", "its 1 points must be at least one, and finite"),
        ("a.glb", b"glTF", "it is truncated: 4 of at least 12 bytes"),
    ],
)  # fmt: skip
def test_bad_files_are_refused(name, content, message, tmp_path):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_points(path)
