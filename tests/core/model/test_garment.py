"""Garment mesh: rest data against closed forms and slow loops, files in three formats, every rejection."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import trimesh
from random_models import tube

from physkin_core import Garment, GarmentError, load_garment
from physkin_core.model.garment import face_areas, vertex_normals

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
TWO_FACES = np.array([[0, 1, 2], [0, 2, 3]])
TRIANGLE = np.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]])


def test_rest_data_of_a_square():
    garment = Garment(2 * SQUARE, TWO_FACES)
    lengths = {tuple(edge): length for edge, length in zip(garment.edges.tolist(), garment.edge_lengths)}
    assert lengths == pytest.approx({(0, 1): 2, (1, 2): 2, (2, 3): 2, (0, 3): 2, (0, 2): 8**0.5})
    np.testing.assert_allclose(garment.face_areas, [2, 2])
    np.testing.assert_allclose(garment.vertex_areas, [4 / 3, 2 / 3, 4 / 3, 2 / 3])


def test_edges_and_hinges_against_a_loop_over_all_pairs():
    """Of every pair of faces: a hinge where they share an edge; its third and fourth vertex lie opposite in turn."""
    garment = tube(rings=5, segments=7)
    faces = garment.faces.tolist()
    edges = {tuple(sorted(pair)) for face in faces for pair in combinations(face, 2)}
    assert {tuple(edge) for edge in garment.edges.tolist()} == edges and len(garment.edges) == len(edges)
    expected = set()
    for one, other in combinations(faces, 2):
        shared = set(one) & set(other)
        if len(shared) == 2:
            expected.add((frozenset(shared), frozenset({*one, *other} - shared)))
    found = [(frozenset(h[:2]), frozenset(h[2:])) for h in garment.hinges.tolist()]
    assert set(found) == expected and len(found) == len(expected)
    directed = {(f[k], f[(k + 1) % 3]): f[(k + 2) % 3] for f in faces for k in range(3)}
    for start, end, left, right in garment.hinges.tolist():
        assert directed[start, end] == left and directed[end, start] == right


def test_areas_against_heron_on_any_number_of_leading_axes():
    rng = np.random.default_rng(0)
    vertices, faces = rng.normal(size=(2, 3, 10, 3)), rng.permuted(np.tile(np.arange(10), (7, 1)), axis=1)[:, :3]
    areas = face_areas(vertices, faces)
    assert areas.shape == (2, 3, 7)
    for index in np.ndindex(2, 3):
        for k, (i, j, m) in enumerate(faces):
            p, q, r = vertices[index][[i, j, m]]
            a, b, c = np.linalg.norm(p - q), np.linalg.norm(q - r), np.linalg.norm(r - p)
            s = (a + b + c) / 2
            assert areas[(*index, k)] == pytest.approx(np.sqrt(s * (s - a) * (s - b) * (s - c)))


def test_vertex_normals():
    """Area-weighted: a fine fan on one side does not outweigh the face it fills; unused vertices get +Z."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    normals = vertex_normals(np.asarray(ball.vertices), np.asarray(ball.faces))
    assert (normals * ball.vertices).sum(axis=1).min() > 0.999
    step = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.0, 0, 1], [1, 0, 1], [5, 5, 5]])
    corner = vertex_normals(step, np.array([[0, 1, 3], [0, 5, 1], [0, 4, 5]]))
    np.testing.assert_allclose(corner[6], [0, 0, 1])
    np.testing.assert_allclose(corner[0], np.array([0, 2, 1]) / 5**0.5, atol=1e-12)  # two walls of 1/2, one floor
    np.testing.assert_allclose(np.linalg.norm(corner, axis=1), 1)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_files_keep_shape_and_orientation(tmp_path, suffix):
    garment = tube(rings=4, segments=6)
    path = tmp_path / f"tube.{suffix}"
    trimesh.Trimesh(garment.vertices, garment.faces, process=False).export(path)
    loaded = load_garment(path)
    np.testing.assert_allclose(loaded.vertices[loaded.faces], garment.vertices[garment.faces], atol=1e-6)
    assert len(loaded.faces) == len(garment.faces)
    assert len(loaded.hinges) == len(garment.hinges), "corners of neighbouring faces must be one vertex"


def test_order_of_vertices_is_kept(tmp_path):
    """As it is where no two are equal; that of their first places where some are."""
    garment = tube(rings=4, segments=6)
    order = np.random.default_rng(0).permutation(len(garment.vertices))
    shuffled = trimesh.Trimesh(garment.vertices[order], np.argsort(order)[garment.faces], process=False)
    shuffled.export(tmp_path / "tube.ply")
    loaded = load_garment(tmp_path / "tube.ply")
    np.testing.assert_allclose(loaded.vertices, shuffled.vertices, atol=1e-6)
    np.testing.assert_array_equal(loaded.faces, shuffled.faces)
    doubled = trimesh.Trimesh(np.repeat(shuffled.vertices, 2, axis=0), 2 * shuffled.faces + 1, process=False)
    doubled.export(tmp_path / "doubled.ply")
    again = load_garment(tmp_path / "doubled.ply")
    np.testing.assert_array_equal(again.vertices, loaded.vertices)
    np.testing.assert_array_equal(again.faces, loaded.faces)


def test_texture_seams_do_not_cut_the_cloth(tmp_path):
    """An OBJ whose corners have texture coordinates: one per position but for a seam, where every ring has two."""
    garment = tube(rings=4, segments=6)
    lines = [f"v {x} {y} {z}" for x, y, z in garment.vertices.tolist()]
    lines += [f"vt {segment / 6} {ring / 3}" for ring in range(4) for segment in range(7)]
    for face in garment.faces.tolist():
        over_seam = {v % 6 for v in face} >= {0, 5}
        uv = [v // 6 * 7 + (6 if over_seam and v % 6 == 0 else v % 6) for v in face]
        lines.append("f " + " ".join(f"{v + 1}/{t + 1}" for v, t in zip(face, uv)))
    (tmp_path / "seam.obj").write_text("\n".join(lines))
    loaded = load_garment(tmp_path / "seam.obj")
    assert len(loaded.faces) == len(garment.faces)
    assert len(loaded.vertices) == len(garment.vertices) and len(loaded.hinges) == len(garment.hinges)


@pytest.mark.parametrize("doubled", [False, True])
def test_line_elements_of_an_obj_are_creases(tmp_path, doubled):
    """Along the mesh's own vertices, or, as Blender writes edges that were duplicated, along others at their places."""
    garment = tube(rings=4, segments=6)
    fold = [1, 7, 13]
    lines = [f"v {x} {y} {z}" for x, y, z in garment.vertices.tolist()]
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in garment.faces.tolist()]
    if doubled:
        lines += ["v {} {} {}".format(*garment.vertices[v]) for v in fold] + ["l -3 -2", "l -2 -1"]
    else:
        lines += ["l " + " ".join(str(v + 1) for v in fold)]
    (tmp_path / "fold.obj").write_text("\n".join(lines))
    loaded = load_garment(tmp_path / "fold.obj")
    np.testing.assert_array_equal(loaded.faces, garment.faces)
    assert sorted(map(sorted, loaded.creases.tolist())) == [[1, 7], [7, 13]]
    creased = {frozenset(hinge[:2]) for hinge in loaded.hinges[loaded.creased].tolist()}
    assert creased == {frozenset({1, 7}), frozenset({7, 13})}
    reshaped = loaded.reshaped(1.1 * loaded.vertices)
    np.testing.assert_array_equal(reshaped.creased, loaded.creased)
    assert garment.creases is None and not garment.creased.any()


def apart(tmp_path, *lines: str):
    """The file of two triangles 2 mm apart, and line elements."""
    text = "".join("v {} {} {}\n".format(*corner) for corner in [*TRIANGLE, *(TRIANGLE + [0.0, 0.0, 0.002])])
    path = tmp_path / "apart.obj"
    path.write_text("\n".join([text + "f 1 2 3\nf 4 5 6", *lines, ""]))
    return path


def test_line_elements_that_run_along_no_edge_are_threads(tmp_path):
    """Kept with the vertices that they join: through another shape, and in a part of the mesh. Their order is, too."""
    loaded = load_garment(apart(tmp_path, "l 1 2", "l 6 3", "l 2 5", "l 3 1"))
    np.testing.assert_array_equal(loaded.threads, [[5, 2], [1, 4]])
    np.testing.assert_array_equal(loaded.creases, [[0, 1], [2, 0]])
    np.testing.assert_array_equal(loaded.reshaped(10 * loaded.vertices).threads, loaded.threads)
    both, one = loaded.submesh(np.array([True, True])), loaded.submesh(np.array([True, False]))
    np.testing.assert_array_equal(both.threads, loaded.threads)
    assert one.threads is None and load_garment(apart(tmp_path)).threads is None
    wider = Garment(np.vstack([[9, 9, 9], loaded.vertices]), loaded.faces + 1, threads=loaded.threads + 1)
    np.testing.assert_array_equal(wider.submesh(np.array([True, True])).threads, loaded.threads)


def test_threads_that_hold_nothing_together_are_refused(tmp_path):
    for lines, message in (
        (["l 2 5", "l 3 3"], "1 threads join a vertex to itself, the first is from vertex 2 to 2; give each pair"),
        (["l 2 5", "l 1 4", "l 5 2"], "1 threads are there already, the first is from vertex 4 to 1"),
        (
            ["v 0 0 0.01", "l 2 5", "l 1 7"],
            "1 threads end at a vertex that no face has, the first is from vertex 0 to 6",
        ),
    ):
        with pytest.raises(GarmentError, match=message):
            load_garment(apart(tmp_path, *lines))
    text = apart(tmp_path, "l 1 5", "l 2 4").read_text().replace("0.05", "0.5")
    (tmp_path / "apart.obj").write_text(text)
    with pytest.raises(
        GarmentError, match="2 threads are longer than 0.1 m, up to 0.500 m, the first is from vertex 0"
    ):
        load_garment(tmp_path / "apart.obj")
    with pytest.raises(GarmentError, match="1 threads run along an edge of the mesh"):
        Garment(TRIANGLE, np.array([[0, 1, 2]]), threads=np.array([[2, 1]]))
    with pytest.raises(GarmentError, match="threads hold -1 to 0, allowed 0 to 2"):
        Garment(TRIANGLE, np.array([[0, 1, 2]]), threads=np.array([[0, -1]]))
    for threads in ([[0.0, 1.0]], [0, 1], np.zeros((0, 2), int)):
        with pytest.raises(GarmentError, match=r"must be \(k, 2\) vertex indices, one or more"):
            Garment(TRIANGLE, np.array([[0, 1, 2]]), threads=np.array(threads))


def test_creases_off_the_edges_are_refused(tmp_path):
    text = "".join("v {} {} {}\n".format(*corner) for corner in SQUARE) + "f 1 2 3\nf 1 3 4\n"
    for line, message in (
        ("l 1 9", "a line has corners at vertices that do not exist; there are 4"),
        ("l 1 x", "'l 1 x': 'x' is no corner"),
    ):
        (tmp_path / "odd.obj").write_text(f"{text}{line}\n")
        with pytest.raises(GarmentError, match=message):
            load_garment(tmp_path / "odd.obj")
    for creases in ([[1, 3]], [[2, 2]], [[0, -1]], [[0, 5]], [[0.0, 1.0]], [0, 1], np.zeros((0, 2), int)):
        with pytest.raises(GarmentError, match="creases"):
            Garment(SQUARE, TWO_FACES, np.array(creases))


@pytest.mark.parametrize(
    "vertices, faces, message",
    [
        (SQUARE[:, :2], TWO_FACES, r"vertices \(4, 2\)"),
        (SQUARE, TWO_FACES[:, :2], r"faces \(2, 2\)"),
        (SQUARE, np.zeros((0, 3)), "no faces"),
        (np.where(np.arange(4)[:, None] == 2, np.nan, SQUARE), TWO_FACES, "the first is 2: "),
        (SQUARE, TWO_FACES + 1, "span 1 to 4, allowed 0 to 3"),
        (SQUARE, TWO_FACES - 1, "span -1 to 2"),
        (SQUARE, TWO_FACES + 2**32, "to 4294967299, allowed 0 to 3"),
        (SQUARE, TWO_FACES + 0.5, "faces are of type float64, expected an integer index"),
        (SQUARE, np.array([[0, 1, 2], [0, 2, 2]]), "face 1 is degenerate: area 0.00e"),
        (
            np.vstack([SQUARE, [0, 0, 1.0]]),
            np.array([[0, 1, 2], [0, 2, 3], [0, 2, 4]]),
            r"edge \[0, 2\] is shared by 3",
        ),
    ],
)
def test_unusable_mesh_is_refused(vertices, faces, message):
    with pytest.raises(GarmentError, match=message):
        Garment(vertices, faces)


def test_missing_or_unreadable_file_is_a_garment_error(tmp_path):
    for name, content in (("a.obj", "v 1 2"), ("a.ply", "ply"), ("a.stl", ""), ("a.txt", "garment")):
        with pytest.raises(GarmentError, match=name):
            load_garment(tmp_path / name)
        (tmp_path / name).write_text(content)
        with pytest.raises(GarmentError):
            load_garment(tmp_path / name)
