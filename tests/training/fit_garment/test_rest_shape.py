"""How a mesh was cut and sewn is in what is written and read again: panels in metres and creases."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import sewn_tube, write_sewn

from physkin_core import Garment, load_body_model, load_garment
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.mesh.look import Look
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.model.rest_shape import flat_areas, flat_edges, side_lengths
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.fit_garment.checks import check_garment, write_garment
from physkin_training.fit_garment.fitting import onto_body
from physkin_training.fit_garment.rest_shape import check_rest_shape, laid_out
from physkin_training.fit_garment.verdicts import Checks

WIDTH, HEIGHT = 0.6, 0.33


def sewn_band(*, columns: int = 32, rings: int = 17) -> Garment:
    """Two panels about the waist of the garment maker's body, a little smaller there than they were cut."""
    made = sewn_tube(columns=columns, rings=rings, width=WIDTH, height=HEIGHT, shrunk=0.95)
    radius = np.linalg.norm(made.vertices[:, :2], axis=1).mean()
    vertices = made.vertices * [0.165 / radius, 0.205 / radius, 1.0] + [0.0, 0.0, 0.12]
    return Garment(vertices, made.faces, made.creases, made.panel_places, made.panel_faces)


def rewritten(path, avatar, template) -> tuple[Garment, str, str]:
    """What is read again of a mesh that was checked, and the outcome and words of the verdict. It is exactly what
    training began with, so that a run can be resumed."""
    checked = check_garment(read_mesh(path), avatar, template)
    assert not checked.refused, checked.verdicts[-1]
    write_garment(path.with_name("garment.obj"), checked)
    (verdict,) = [each for each in checked.verdicts if each.check == "flat rest shape"]
    again = load_garment(path.with_name("garment.obj"))
    for name in ("vertices", "faces", "creases", "panel_places", "panel_faces", "threads"):
        np.testing.assert_array_equal(getattr(checked.garment, name), getattr(again, name), err_msg=name)
    return again, verdict.outcome, verdict.found


def test_panels_and_creases_are_kept_through_repairs(template, tmp_path):
    """In centimetres, Y up, every third face wound the other way, and too coarse: it is refined."""
    band = sewn_band(columns=6, rings=5)
    path = tmp_path / "band.obj"
    write_sewn(path, band)
    lines = []
    for number, line in enumerate(path.read_text().splitlines()):
        kind, *entries = line.split()
        if kind == "v":
            x, y, z = (100 * float(entry) for entry in entries)
            line = f"v {y} {z} {x}"
        elif kind == "f" and number % 3 == 0:
            line = " ".join(["f", *entries[::-1]])
        lines.append(line)
    path.write_text("\n".join(lines))
    found, outcome, words = rewritten(path, template, template)
    assert outcome == "ok" and words.startswith(
        "2 flat panels of 0.40 m2: texture coordinates in metres, the median edge"
    )
    assert len(found.faces) > 3 * len(band.faces)
    assert found.face_areas.sum() == pytest.approx(2 * WIDTH * HEIGHT, rel=1e-4)
    on_seam = found.vertices[found.creases.reshape(-1)]
    np.testing.assert_allclose(on_seam[:, 1], 0.0, atol=1e-6)
    rest = sum(np.linalg.norm(np.diff(found.vertices[pair], axis=0)) for pair in found.creases)
    assert rest == pytest.approx(2 * 0.95 * HEIGHT, rel=1e-4)


def test_threads_are_kept_through_repairs(template, tmp_path):
    """By position: in centimetres, Y up, with every vertex twice, and refined. One through the body is too long."""
    band = sewn_band(columns=12, rings=9)
    over, behind = (int(np.argmax(side * band.vertices[:, 0] + band.vertices[:, 2])) for side in (1, -1))
    joined = {v for edge in band.edges.tolist() if over in edge for v in edge}
    near = np.argsort(np.linalg.norm(band.vertices - band.vertices[over], axis=1)).tolist()
    under = next(v for v in near if v not in joined)
    lines = [f"v {100 * y} {100 * z} {100 * x}" for x, y, z in np.repeat(band.vertices, 2, axis=0).tolist()]
    lines += ["f " + " ".join(str(2 * v + 1 + k % 2) for v in face) for k, face in enumerate(band.faces)]
    lines += [f"l {2 * over + 2} {2 * under + 1}", f"l {2 * over + 1} {2 * behind + 1}"]
    path = tmp_path / "band.obj"
    path.write_text("\n".join(lines))
    checked = check_garment(read_mesh(path), template, template)
    (said,) = [each for each in checked.verdicts if each.check == "threads"]
    assert (said.outcome, said.found) == ("warning", "1 threads, 1 left out")
    write_garment(tmp_path / "garment.obj", checked)
    again = load_garment(tmp_path / "garment.obj")
    assert len(again.vertices) > 3 * len(band.vertices) and again.creases is None
    np.testing.assert_array_equal(checked.garment.threads, again.threads)
    np.testing.assert_allclose(again.vertices[again.threads[0]], band.vertices[[over, under]], atol=2e-3)


def test_panels_are_graded_to_the_template_with_a_mesh_of_another_body(template, tmp_path):
    """Each face of a panel is stretched about as its face of the mesh is, and the panels are whole."""
    body_model = load_body_model()
    tallest = max(body_model.held_out_bodies, key=lambda c: np.ptp(body_model.vertices(c)[:, 2]))
    tall = avatar_from_body(body_model, tallest)
    band = sewn_band()
    on_tall = BodySurface(tall.vertices, tall.faces).push_out(onto_body(band.vertices, template, tall), 0.005)
    write_sewn(tmp_path / "band.obj", band.reshaped(on_tall))
    plain = load_garment(tmp_path / "band.obj")
    assert plain.panel_places is not None
    found, outcome, words = rewritten(tmp_path / "band.obj", tall, template)
    assert outcome == "repaired" and "graded to the template, edges by" in words
    assert len(found.panel_places) == len(plain.panel_places)
    smaller = (
        Garment(found.vertices, found.faces).face_areas.sum() / Garment(plain.vertices, plain.faces).face_areas.sum()
    )
    assert found.face_areas.sum() / plain.face_areas.sum() == pytest.approx(smaller, rel=0.03) and smaller < 0.98


def test_texture_places_that_are_no_panels_stay_a_look(template, tmp_path):
    band = sewn_band()
    for scale, words in (
        (0.1, "none, it rests as it lies: texture coordinates are not in metres"),
        (None, "no texture"),
    ):
        path = tmp_path / "band.obj"
        write_sewn(path, band)
        text = path.read_text().splitlines()
        places = iter(band.panel_places * (scale or 1))
        text = ["vt {} {}".format(*next(places)) if line.startswith("vt") else line for line in text]
        if scale is None:
            text = [" ".join(entry.partition("/")[0] for entry in line.split(" ")) for line in text if "vt" not in line]
        path.write_text("\n".join(text))
        found, outcome, said = rewritten(path, template, template)
        assert outcome == "ok" and words in said and found.panel_places is None
        assert ("vt" in path.with_name("garment.obj").read_text()) == (scale is not None)


def test_panels_of_another_size_are_warned_of(template, tmp_path):
    """They may be meant: a shirt two sizes too large; or be in metres by accident."""
    band = sewn_band()
    larger = Garment(band.vertices, band.faces, None, 1.12 * band.panel_places, band.panel_faces)
    write_sewn(tmp_path / "band.obj", larger)
    found, outcome, words = rewritten(tmp_path / "band.obj", template, template)
    assert outcome == "warning" and "times as large as the mesh: if they are not meant in metres, scale them" in words
    assert found.face_areas.sum() == pytest.approx(1.12**2 * 2 * WIDTH * HEIGHT, rel=1e-4)


def test_panels_that_cannot_be_graded_are_dropped():
    """A mesh that was torn into shreds of other sizes: no flat cloth is like it."""
    band = sewn_band()
    look = Look(band.panel_places[band.panel_faces], *np.full((2, len(band.faces)), -1))
    torn = band.vertices * np.random.default_rng(0).uniform(0.2, 3, size=band.vertices.shape)
    checks = Checks(torn, band.faces, np.zeros((0, 2, 3)))
    left = check_rest_shape(checks, look, band.vertices, band.vertices)
    (verdict,) = checks.verdicts
    assert (
        verdict.outcome == "warning" and "dropped, and the texture coordinates with it: graded to the" in verdict.found
    )
    assert np.isnan(left.uv).all()


def test_panels_that_repairs_have_squashed_are_told_of():
    """One face pushed out of the body until it is a tenth of what it was cut: a warning, and the look is kept."""
    band = sewn_band()
    look = Look(band.panel_places[band.panel_faces], *np.full((2, len(band.faces)), -1))
    squashed = band.vertices.copy()
    corners = band.faces[200]
    squashed[corners[0]] = 0.05 * band.vertices[corners[0]] + 0.95 * band.vertices[corners[1:]].mean(axis=0)
    checks = Checks(squashed, band.faces, np.zeros((0, 2, 3)))
    assert check_rest_shape(checks, look, band.vertices, squashed) is look
    (verdict,) = checks.verdicts
    assert verdict.outcome == "warning" and "dropped, it rests as it lies: after repairs texture" in verdict.found
    assert "face 200 has" in verdict.found
    checks = Checks(1.1 * squashed, band.faces, np.zeros((0, 2, 3)))  # carried to a larger body afterwards
    assert np.isnan(check_rest_shape(checks, look, band.vertices, squashed).uv).all()
    (verdict,) = checks.verdicts
    assert verdict.outcome == "warning" and "the texture coordinates with it: after repairs texture" in verdict.found


def test_panels_are_laid_out_at_given_edges():
    """Against those of a panel that was stretched: found exactly, also seen from the other side."""
    band = sewn_band()
    stretched = band.panel_places * [1.1, 0.95] + 0.02 * np.sin(9 * band.panel_places[:, ::-1])
    for mirror in (1, -1):
        places, goal = ([mirror, 1] * x for x in (band.panel_places, stretched))
        wanted = flat_edges(goal[band.panel_faces])
        found = laid_out(places, band.panel_faces, wanted)[band.panel_faces]
        assert (np.sign(flat_areas(found)) == mirror).all()
        got = flat_edges(found)
        np.testing.assert_allclose(side_lengths(got), side_lengths(wanted), rtol=2e-3)
