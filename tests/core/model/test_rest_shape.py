"""Cloth that was cut flat: its rest shape against the panels' closed forms, in files, graded, and every rejection."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from model_files import contents, sealed, written
from random_models import random_model, sewn_tube, tube, write_sewn
from scipy.linalg import polar

from physkin_core import Garment, GarmentError, ModelFileError, load_garment, load_garment_model, save_garment_model
from physkin_core.cli import main
from physkin_core.formats.deflated_tensors import inflate_tensors
from physkin_core.model.faces_of_panels import with_faces, without_faces
from physkin_core.model.garment import face_areas
from physkin_core.quality import area_strain, edge_strain
from physkin_core.tensor_file import read_tensors

WIDTH, HEIGHT, SHRUNK = 0.45, 0.4, 0.92
REST = ("rest_edges", "edge_lengths", "face_areas", "vertex_areas")


@pytest.fixture
def sewn() -> Garment:
    """Cut larger than it lies."""
    return sewn_tube(width=WIDTH, height=HEIGHT, shrunk=SHRUNK)


def sizes(garment: Garment, sides: np.ndarray) -> np.ndarray:
    """Lengths (e,) of edges that run by `sides` (f, 3, k) of faces, edge by edge from the first face that has it."""
    found = {}
    for face, vectors in zip(garment.faces.tolist(), sides):
        for k in range(3):
            found.setdefault(frozenset((face[k], face[(k + 1) % 3])), np.linalg.norm(vectors[k]))
    return np.array([found[frozenset(edge)] for edge in garment.edges.tolist()])


def test_rest_is_that_of_the_panels(sewn):
    """Areas and lengths of two rectangles, whatever the tube lies like; strains are against these."""
    assert sewn.face_areas.sum() == pytest.approx(2 * WIDTH * HEIGHT) == sewn.vertex_areas.sum()
    assert len(sewn.panel_places) == len(sewn.vertices) + 2 * 9, "a place on each panel for vertices on both seams"
    places = sewn.panel_places[sewn.panel_faces]
    np.testing.assert_allclose(sewn.edge_lengths, sizes(sewn, np.roll(places, -1, axis=1) - places))
    lying = Garment(sewn.vertices, sewn.faces)
    ratio = lying.face_areas.sum() / sewn.face_areas.sum()
    assert ratio == pytest.approx(SHRUNK**2, rel=0.02)
    np.testing.assert_array_equal(lying.face_areas, face_areas(sewn.vertices, sewn.faces))
    assert area_strain(sewn, sewn.vertices) == pytest.approx(100 * (1 - ratio)) and edge_strain(sewn, sewn.vertices) > 7


def test_at_a_seam_an_edge_is_as_long_as_its_sides_are_on_average():
    sewn = sewn_tube(columns=4, rings=3)
    places = sewn.panel_places.copy()
    second = np.arange(len(places)) >= len(places) // 2
    places[second, 1] *= 1.3
    uneven = Garment(sewn.vertices, sewn.faces, None, places, sewn.panel_faces)
    seam = (np.isin(uneven.edges, [0, 8, 16])).all(axis=1)
    np.testing.assert_allclose(uneven.edge_lengths[seam], 0.2 * (1 + 1.3) / 2)
    assert seam.sum() == 2 and uneven.edge_lengths[seam] != pytest.approx(sewn.edge_lengths[seam])


def test_reshaped_stretches_the_panels_as_the_mesh(sewn):
    """Its own vertices: the same bit for bit. Wider and taller: so are the panels of an upright tube, gathered or not.
    In steps as at once; and on its own mesh again, the panels as they were cut."""
    again = sewn.reshaped(sewn.vertices.astype(np.float64))
    for name in REST:
        np.testing.assert_array_equal(getattr(again, name), getattr(sewn, name), err_msg=name)
    gathered = Garment(sewn.vertices, sewn.faces, None, sewn.panel_places * [1.5, 1], sewn.panel_faces)
    ruffled = gathered.reshaped(sewn.vertices * [1.1, 1.1, 1.25])
    wide = Garment(sewn.vertices, sewn.faces, None, sewn.panel_places * [1.65, 1.25], sewn.panel_faces)
    np.testing.assert_allclose(ruffled.edge_lengths, wide.edge_lengths)
    larger = sewn.reshaped(sewn.vertices * [1.1, 1.1, 1.25])
    expected = Garment(sewn.vertices, sewn.faces, None, sewn.panel_places * [1.1, 1.25], sewn.panel_faces)
    for name in REST[1:]:
        np.testing.assert_allclose(getattr(larger, name), getattr(expected, name), err_msg=name)
    np.testing.assert_array_equal(larger.panel_places, sewn.panel_places)
    rng = np.random.default_rng(0)
    bumpy = sewn.vertices * (1 + 0.05 * rng.normal(size=sewn.vertices.shape))
    at_once, in_steps = sewn.reshaped(bumpy), larger.reshaped(bumpy)
    back = at_once.reshaped(sewn.vertices)
    for name in REST:
        np.testing.assert_allclose(getattr(in_steps, name), getattr(at_once, name), rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(getattr(back, name), getattr(sewn, name), rtol=1e-9, atol=1e-14)
    with pytest.raises(GarmentError, match="degenerate"):
        sewn.reshaped(0 * sewn.vertices)


def test_reshaped_against_matrices_face_by_face(sewn):
    """D = D_shape inverse(D_base) R D_flat, each in the frame of its first edge; R is the rotation of the polar
    decomposition of the deformation D_base inverse(D_flat)."""
    rng = np.random.default_rng(1)
    bumpy = sewn.vertices * (1 + 0.05 * rng.normal(size=sewn.vertices.shape))

    def matrix(corners: np.ndarray) -> np.ndarray:
        edges = (corners[1:] - corners[0]).T
        first = edges[:, 0] / np.linalg.norm(edges[:, 0])
        second = edges[:, 1] - first * (first @ edges[:, 1])
        return np.stack([first, second / np.linalg.norm(second)]) @ edges

    found = sewn.reshaped(bumpy).rest_edges
    for k, (face, panel_face) in enumerate(zip(sewn.faces, sewn.panel_faces)):
        base, shape, flat = (matrix(x) for x in (sewn.vertices[face], bumpy[face], sewn.panel_places[panel_face]))
        turn, _ = polar(base @ np.linalg.inv(flat))
        np.testing.assert_allclose(found[k], shape @ np.linalg.inv(base) @ turn @ flat, atol=1e-13)


def test_some_of_the_faces_keep_the_rest_shape(sewn):
    larger = sewn.reshaped(sewn.vertices * [1.1, 1.1, 1.25])
    upper = larger.vertices[larger.faces].mean(axis=1)[:, 2] > 0
    part = larger.submesh(upper)
    np.testing.assert_array_equal(part.face_areas, larger.face_areas[upper])
    np.testing.assert_array_equal(part.vertices, larger.vertices[np.unique(larger.faces[upper])])
    assert part.edge_lengths.max() == pytest.approx(larger.edge_lengths.max())


def test_a_model_file_keeps_panels(sewn, tmp_path, capsys):
    """And `physkin info` tells of them; without panels it holds none."""
    model = random_model(np.random.default_rng(0), garment=sewn)
    save_garment_model(model, tmp_path / "sewn.safetensors")
    loaded = load_garment_model(tmp_path / "sewn.safetensors").garment
    np.testing.assert_array_equal(loaded.panel_faces, sewn.panel_faces)
    np.testing.assert_allclose(loaded.panel_places, sewn.panel_places, atol=2e-6)
    np.testing.assert_array_equal(loaded.faces, sewn.faces)
    np.testing.assert_allclose(loaded.edge_lengths, sewn.edge_lengths, rtol=1e-4)
    save_garment_model(replace(model, garment=Garment(sewn.vertices, sewn.faces)), tmp_path / "plain.safetensors")
    names = [set(contents(tmp_path / f"{name}.safetensors")[1]) for name in ("sewn", "plain")]
    for name, told in (("sewn", "flat panels that it was cut from"), ("plain", "as its mesh lies")):
        assert main(["info", str(tmp_path / f"{name}.safetensors")]) == 0
        assert re.search(f"rest shape +.*{told}", capsys.readouterr().out)
    assert names[0] - names[1] == {"garment.panel_places", "garment.panel_faces", "garment.creases"}


@pytest.mark.parametrize(
    "part, change, message",
    [
        ("vertices", lambda vertices: vertices[:-1], "must hold indices from 0 to 124, the places"),
        ("vertices", lambda vertices: vertices + 1, "face indices span"),
        ("vertices", lambda vertices: vertices.astype(np.float32), "must be an integer index"),
        ("vertices", lambda vertices: vertices[:, None], "must be an integer index"),
        ("faces", lambda faces: faces.astype(np.float32), "must be an integer index"),
        ("faces", lambda faces: faces.astype(np.int16) - 1, "must hold indices from 0 to 125"),
        ("faces", lambda faces: faces[:0], "must hold indices from 0 to 125"),
    ],
)
def test_panels_that_tell_no_faces_are_refused(sewn, tmp_path, part, change, message):
    """A file holds the vertex of each panel place instead of faces, which follow."""
    path = tmp_path / "sewn.safetensors"
    save_garment_model(random_model(np.random.default_rng(0), garment=sewn), path)
    metadata, tensors = inflate_tensors(*read_tensors(path.read_bytes()))
    assert "garment.faces" not in tensors
    name = f"garment.panel_{part}"
    written(path, sealed(metadata, tensors | {name: change(tensors[name])}))
    with pytest.raises(ModelFileError, match=message):
        load_garment_model(path)


def test_faces_that_panels_do_not_tell_are_stored():
    """Where two vertices share a place on a panel."""
    faces = np.array([[0, 1, 2], [3, 4, 5]], np.uint8)
    tensors = {"garment.faces": faces, "garment.panel_faces": np.array([[0, 1, 2], [0, 2, 3]], np.uint8)}
    assert without_faces(tensors) == tensors
    apart = tensors | {"garment.panel_faces": faces}
    assert "garment.faces" not in without_faces(apart)
    np.testing.assert_array_equal(with_faces(without_faces(apart))["garment.faces"], faces)


def test_an_obj_with_texture_places_in_metres_brings_its_panels(sewn, tmp_path):
    """Welded or not, mirrored as a whole or not, moved and overlapping in the plane."""
    write_sewn(tmp_path / "sewn.obj", sewn)
    loaded = load_garment(tmp_path / "sewn.obj")
    np.testing.assert_allclose(loaded.edge_lengths, sewn.edge_lengths, rtol=1e-6)
    np.testing.assert_array_equal(loaded.creases, sewn.creases)
    assert len(loaded.panel_places) == len(sewn.panel_places)
    split = [f"v {x} {y} {z}" for x, y, z in sewn.vertices[sewn.faces].reshape(-1, 3).tolist()]
    laid = sewn.panel_places * [-1, 1] + np.where(sewn.panel_places[:, :1] > 0.5, [[0.55, 0.0]], [[0.0, 3.0]])
    split += [f"vt {u} {v}" for u, v in laid[sewn.panel_faces].reshape(-1, 2).tolist()]
    split += [f"f {k}/{k} {k + 1}/{k + 1} {k + 2}/{k + 2}" for k in range(1, 3 * len(sewn.faces), 3)]
    (tmp_path / "split.obj").write_text("\n".join(split))
    other = load_garment(tmp_path / "split.obj")
    assert len(other.vertices) == len(sewn.vertices)
    np.testing.assert_allclose(other.face_areas, sewn.face_areas, rtol=1e-6)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda places: places / 1.5,
        lambda places: 1000 * places,
        lambda places: 1e300 * places,
        lambda places: 0 * places,
        lambda places: places * np.where(places[:, :1] > 0.5, [[-1, 1]], [[1, 1]]),
        lambda places: places * np.where(places[:, 1:] > 0.3, [[2.1, 1]], [[1, 1]]),
    ],
)
def test_other_texture_places_are_ignored(sewn, spoil, tmp_path):
    """Of another size, of none, one panel turned over, one part stretched."""
    garment = replace(sewn, panel_places=None, panel_faces=None)
    object.__setattr__(garment, "panel_places", spoil(sewn.panel_places))
    object.__setattr__(garment, "panel_faces", sewn.panel_faces)
    write_sewn(tmp_path / "other.obj", garment)
    loaded = load_garment(tmp_path / "other.obj")
    assert loaded.panel_places is None
    np.testing.assert_allclose(loaded.face_areas, face_areas(sewn.vertices, sewn.faces), rtol=1e-6)


def moved(places: np.ndarray, place: int, to: list[float]) -> np.ndarray:
    return np.where(np.arange(len(places))[:, None] == place, to, places)


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda p, f: (p, None), "both panel places and panel faces, or neither"),
        (lambda p, f: (None, f), "both panel places and panel faces, or neither"),
        (lambda p, f: (p[:, :1], f), r"panel places \(126, 1\) and faces \(192, 3\) must be \(t, 2\) and \(192, 3\)"),
        (lambda p, f: (p, f[1:]), r"faces \(191, 3\) must be \(t, 2\) and \(192, 3\)"),
        (lambda p, f: (moved(p, 3, [np.nan, 0]), f), r"1 panel places are not finite, the first is 3: \[nan, 0.0\]"),
        (lambda p, f: (p, f + 0.5), "panel faces are of type float64, expected an integer index"),
        (lambda p, f: (p, f - 1), "panel faces hold -1 to 124, allowed 0 to 125"),
        (lambda p, f: (p, f + 1), "panel faces hold 1 to 126, allowed 0 to 125"),
        (lambda p, f: (moved(p, 0, p[1]), f), "face 0 is degenerate on the flat cloth: its area is 0.00e"),
        (lambda p, f: (moved(p, 0, [0.1, 0.04]), f), "face 0 is turned over on the flat cloth: its area is -"),
        (lambda p, f: (1.9 * p, f), r"face \d+ has 6769 mm2 on the flat cloth and 15\d\d mm2 in the mesh, allowed: a"),
    ],
)
def test_unusable_panels_are_refused(sewn, spoil, message):
    with pytest.raises(GarmentError, match=message):
        Garment(sewn.vertices, sewn.faces, None, *spoil(sewn.panel_places, sewn.panel_faces))


def test_a_mesh_without_panels_rests_as_it_lies():
    garment = tube()
    corners = garment.vertices[garment.faces]
    np.testing.assert_allclose(garment.edge_lengths, sizes(garment, np.roll(corners, -1, axis=1) - corners))
    np.testing.assert_array_equal(garment.face_areas, face_areas(garment.vertices, garment.faces))
