"""Each defect of a garment mesh, made on purpose, is found; what can be repaired is, and passes afterwards."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the [training] extra")
pytest.importorskip("warp", reason="needs the [training] extra")

from physkin_core import load_body_model, load_garment  # noqa: E402
from physkin_core.avatar.avatar import avatar_from_body  # noqa: E402
from physkin_core.model.garment import GarmentError  # noqa: E402
from physkin_training.fit_garment.garment_checks import CheckedGarment, check_garment, check_mesh, write_garment  # noqa: E402
from physkin_training.fit_garment.garment_fitting import CLEARANCE, carried  # noqa: E402
from physkin_training.fit_garment.mesh_repair import refined  # noqa: E402
from physkin_training.fit_garment.verdicts import verdict_table  # noqa: E402
from physkin_training.physics.surface_queries import BodySurface, piercing_edges  # noqa: E402

GARMENTS = Path(__file__).parents[3] / "training" / "garments"
Y_UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
CHECKS = [
    "triangles", "units", "orientation", "position", "duplicates", "manifold", "pieces", "winding", "openings",
    "scale", "edge length", "one layer", "overlap", "body", "self-intersection",
]  # fmt: skip


@pytest.fixture(scope="module")
def template():
    body_model = load_body_model()
    return avatar_from_body(body_model, body_model.garment_body)


@pytest.fixture(scope="module")
def tall():
    """The tallest of the held-out bodies."""
    body_model = load_body_model()
    bodies = [avatar_from_body(body_model, c) for c in body_model.held_out_bodies]
    return max(bodies, key=lambda body: np.ptp(body.vertices[:, 2]))


@pytest.fixture(scope="module")
def surface(template):
    return BodySurface(template.vertices, template.faces)


@pytest.fixture(scope="module")
def shirt():
    """The shipped T-shirt: vertices (n, 3) and faces (f, 3), fresh copies on every use."""
    garment = load_garment(GARMENTS / "tshirt.obj")
    return lambda: (garment.vertices.copy(), garment.faces.copy())


def outcomes(checked: CheckedGarment) -> dict[str, str]:
    """Outcome by check, of those that are not ok."""
    return {verdict.check: verdict.outcome for verdict in checked.verdicts if verdict.outcome != "ok"}


def found(checked: CheckedGarment, check: str) -> str:
    return next(verdict.found for verdict in checked.verdicts if verdict.check == check)


@pytest.mark.parametrize("name", ["tshirt", "longsleeve", "dress", "trousers", "skirt"])
def test_a_shipped_garment_passes_everything_unchanged(name, template):
    checked = check_garment(GARMENTS / f"{name}.obj", template, template)
    assert [verdict.check for verdict in checked.verdicts] == CHECKS
    assert outcomes(checked) == {}
    garment = load_garment(GARMENTS / f"{name}.obj")
    np.testing.assert_array_equal(checked.vertices, garment.vertices)
    np.testing.assert_array_equal(checked.faces, garment.faces)


def inches_y_up(v, f):
    return v @ Y_UP.T / 0.0254, f


def millimetres(v, f):
    return 1000 * v, f


def centimetres_on_the_floor(v, f):
    return 100 * (v + [0, 0, 0.9141]), f


def facing_backwards(v, f):
    return v * [-1, -1, 1], f


def soup(v, f):
    return v[f].reshape(-1, 3), np.arange(f.size).reshape(-1, 3)


def degenerate(v, f):
    return v, np.concatenate([f, f[:3], [[5, 5, 9]]])


def fin(v, f):
    return np.concatenate([v, [v[f[100, 0]] + [0.0, 0.004, 0.004]]]), np.concatenate([f, [[*f[100, :2], len(v)]]])


def mixed_winding(v, f):
    return v, np.where((np.arange(len(f)) % 3 == 0)[:, None], f[:, ::-1], f)


def inside_out(v, f):
    return v, f[:, ::-1].copy()


def button(v, f):
    disc = v[f[2000]] + 0.008 * np.array([1.0, 0, 0])
    return np.concatenate([v, disc]), np.concatenate([f, len(v) + np.arange(3)[None]])


def dented(v, f):
    chest = np.linalg.norm(v - [0.13, 0.0, 0.35], axis=1)
    return v - 0.04 * np.exp(-((chest / 0.06) ** 2))[:, None] * [1, 0, 0], f


@pytest.mark.parametrize(
    ("spoil", "check", "words"),
    [
        (inches_y_up, "units", "inches"),
        (inches_y_up, "orientation", "Y up, Z forward"),
        (millimetres, "units", "millimetres"),
        (centimetres_on_the_floor, "units", "centimetres"),
        (centimetres_on_the_floor, "position", "moved by (0.000, 0.000, -0.914)"),
        (facing_backwards, "orientation", "Z up, -X forward"),
        (soup, "duplicates", "19037 duplicate vertices"),
        (degenerate, "duplicates", "4 degenerate or repeated"),
        (fin, "manifold", "1 faces at edges"),
        (mixed_winding, "winding", "2551 faces turned"),
        (inside_out, "winding", "inside out"),
        (button, "pieces", "1 scraps dropped"),
        (dented, "overlap", "vertices in the body"),
    ],
)
def test_a_defect_is_found_and_repaired(spoil, check, words, shirt, template, surface):
    checked = check_mesh(*spoil(*shirt()), template, template)
    assert not checked.refused
    assert outcomes(checked)[check] == "repaired"
    assert words in found(checked, check)
    again = check_mesh(checked.vertices, checked.faces, template, template)
    assert outcomes(again) == {}
    vertices, _ = shirt()
    assert checked.vertices.shape == vertices.shape
    if spoil is dented:
        assert surface.closest(checked.vertices).distance.min() >= CLEARANCE - 1e-5
        assert surface.closest(spoil(*shirt())[0]).distance.min() < -0.005, "the test must begin inside the body"
    else:
        gap = np.linalg.norm(checked.vertices[:, None] - vertices[::97], axis=-1).min(axis=0)
        assert gap.max() < 2e-4


def test_a_pinched_vertex_is_split(template):
    """Two halves of a skirt that hang together at one vertex come apart there, and are then two pieces."""
    garment = load_garment(GARMENTS / "skirt.obj")
    left = (garment.vertices[garment.faces, 1] > 0).all(axis=1)
    right = (garment.vertices[garment.faces, 1] < 0).all(axis=1)
    faces = garment.faces[left | right].copy()
    first, second = garment.faces[left][0, 0], garment.faces[right][0, 0]
    faces[faces == first] = second
    checked = check_mesh(garment.vertices, faces, template, template)
    assert "1 vertices that pinch" in found(checked, "manifold")
    assert outcomes(checked)["pieces"] == "warning"


def test_coarse_triangles_are_refined_on_the_same_surface(shirt, template):
    ring = 24
    angle = np.arange(ring) * 2 * np.pi / ring
    height = np.linspace(0.0, 0.2, 5)
    vertices = np.stack(
        [np.tile(0.2 * np.cos(angle), 5), np.tile(0.24 * np.sin(angle), 5), np.repeat(height, ring)], axis=1
    )
    index = np.arange(5 * ring).reshape(5, ring)
    a, b = index[:-1].ravel(), np.roll(index, -1, 1)[:-1].ravel()
    c, d = np.roll(index, -1, 1)[1:].ravel(), index[1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    checked = check_mesh(vertices, faces, template, template)
    assert outcomes(checked)["edge length"] == "repaired"
    assert len(checked.faces) == 16 * len(faces)


def finer(v, f):
    long = load_garment(GARMENTS / "longsleeve.obj")
    return refined(long.vertices, long.faces)


def doubled(v, f):
    outer = v + 0.003 * np.array([1.0, 0, 0])
    return np.concatenate([v, outer]), np.concatenate([f, f[:, ::-1] + len(v)])


def closed(v, f):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.22)
    return ball.vertices * [1, 1.2, 1.5] + [0.02, 0, 0.2], ball.faces


def moebius(v, f):
    """A band about the waist with one half twist."""
    s = 160
    angle = np.linspace(0, 2 * np.pi, s, endpoint=False)
    across = np.linspace(-0.03, 0.03, 5)[:, None]
    radius = 0.22 + across * np.cos(angle / 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.1 + across * np.sin(angle / 2)], axis=-1)
    faces = []
    for row in range(4):
        for k in range(s):
            a, d = row * s + k, (row + 1) * s + k
            b, c = (a + 1, d + 1) if k + 1 < s else ((4 - row) * s, (3 - row) * s)
            faces += [[a, b, c], [a, c, d]]
    return points.reshape(-1, 3), np.array(faces)


def shrunk(v, f):
    return (v - v.mean(axis=0)) * [0.75, 0.75, 1] + v.mean(axis=0), f


def huge(v, f):
    return 1e5 * v, f


def book(v, f):
    """A third sheet along many edges."""
    return (
        np.concatenate([v, v[f[::20]].mean(axis=1) + [0.01, 0, 0]]),
        np.concatenate([f, np.column_stack([f[::20, :2], len(v) + np.arange(len(f[::20]))])]),
    )


def test_a_mesh_from_anywhere_is_put_on_the_body(shirt, template):
    """No usual origin: the place is searched, which is warned of, and found to about a centimetre."""
    vertices, faces = shirt()
    checked = check_mesh(1000 * (vertices @ Y_UP.T + [0.3, 0.5, -0.2]), faces, template, template)
    expected = {"units": "repaired", "orientation": "repaired", "position": "warning", "overlap": "repaired"}
    assert outcomes(checked) == expected
    assert "front and height" in found(checked, "position")
    assert np.abs(checked.vertices - vertices).max() < 0.02


@pytest.mark.parametrize(
    ("spoil", "check", "words"),
    [
        (closed, "openings", "it is closed"),
        (moebius, "winding", "only one side"),
        (shrunk, "overlap", "vertices in the body"),
        (huge, "units", "longest extent"),
        (book, "manifold", "faces at edges of three"),
        (doubled, "one layer", "export the outer surface only"),
        (lambda v, f: (np.where(np.arange(len(v))[:, None] == 7, np.nan, v), f), "triangles", "1 vertices have no"),
        (lambda v, f: (v, f[:0]), "triangles", "no faces"),
        (lambda v, f: (v, f + 1), "triangles", "vertices that are not there"),
    ],
)  # fmt: skip
def test_what_cannot_be_repaired_is_refused(spoil, check, words, shirt, template):
    checked = check_mesh(*spoil(*shirt()), template, template)
    assert checked.refused
    assert checked.verdicts[-1].check == check and checked.verdicts[-1].outcome == "refused"
    assert words in checked.verdicts[-1].found


def hole(v, f):
    return v, np.delete(f, 3000, axis=0)


def crossing(v, f):
    """The end of a sleeve is pushed back through the sleeve."""
    sleeve = (v[:, 1] > 0.30) & (v[:, 2] > 0.3)
    return v - 0.06 * sleeve[:, None] * [0.0, 1.0, 0.0], f


@pytest.mark.parametrize(
    ("spoil", "check", "words"),
    [
        (hole, "openings", "4 openings, 1 holes"),
        (finer, "edge length", "finer than training needs"),
        (crossing, "self-intersection", "edges go through a face"),
    ],
)
def test_a_warning_leaves_the_mesh_alone(spoil, check, words, shirt, template):
    checked = check_mesh(*spoil(*shirt()), template, template)
    assert outcomes(checked)[check] == "warning"
    assert words in found(checked, check)


def test_a_garment_much_too_large_is_warned_of(shirt, template):
    vertices, faces = shirt()
    centre = vertices.mean(axis=0)
    checked = check_mesh(1.18 * (vertices - centre) + centre, faces, template, template)
    assert outcomes(checked).get("scale") == "warning"


def test_piercing_edges_are_those_that_cross():
    """Two triangles that cross have two piercing edges, none once apart; neighbours never count."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -0.5], [0.3, 0.2, 0.5], [0.2, 0.3, 0.5]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    edges = np.array([[0, 1], [1, 2], [2, 0], [3, 4], [4, 5], [5, 3]])
    np.testing.assert_array_equal(piercing_edges(vertices, faces, edges), [0, 0, 0, 1, 0, 1])
    assert not piercing_edges(vertices + np.repeat([[0], [2]], 3, axis=0), faces, edges).any()


def test_a_garment_of_another_body_is_carried_over(shirt, template, tall):
    """There and back again is nearly the same; what was made on a tall body fits the template, with a warning."""
    vertices, faces = shirt()
    there = carried(vertices, template, tall)
    assert np.linalg.norm(there - vertices, axis=1).max() > 0.02
    assert np.linalg.norm(carried(there, tall, template) - vertices, axis=1).mean() < 0.005
    on_tall = BodySurface(tall.vertices, tall.faces).push_out(there, 0.005)
    checked = check_mesh(on_tall, faces, tall, template)
    assert not checked.refused
    assert outcomes(checked)["body"] == "warning"
    assert "another body" in found(checked, "body")
    assert np.linalg.norm(checked.vertices - vertices, axis=1).mean() < 0.02
    assert outcomes(check_mesh(checked.vertices, checked.faces, template, template)) == {}


def test_quads_are_cut_and_files_round_trip(tmp_path, template):
    checked = check_garment(GARMENTS / "skirt.obj", template, template)
    write_garment(tmp_path / "skirt.obj", checked)
    garment = load_garment(tmp_path / "skirt.obj")
    np.testing.assert_allclose(garment.vertices, checked.vertices, atol=1e-7)
    np.testing.assert_array_equal(garment.faces, checked.faces)
    text = (tmp_path / "skirt.obj").read_text().splitlines()
    ring = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    points = np.concatenate([np.stack([0.2 * np.cos(ring), 0.24 * np.sin(ring), 0 * ring + h], 1) for h in (0.1, 0.12)])
    text = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.tolist()]
    text += [f"f {k + 1} {(k + 1) % 64 + 1} {(k + 1) % 64 + 65} {k + 65}" for k in range(64)]
    (tmp_path / "quads.obj").write_text("\n".join(text))
    checked = check_garment(tmp_path / "quads.obj", template, template)
    assert outcomes(checked)["triangles"] == "repaired"
    assert "128 triangles, 128 vertices, from 64 faces" in found(checked, "triangles")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("nosuch.obj", None, "no such file"),
        ("shirt.fbx", "", "unknown extension '.fbx'; allowed: .obj"),
        ("empty.obj", "", "holds no faces"),
    ],
)
def test_a_file_without_a_mesh_is_an_error(name, content, reason, tmp_path, template):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(GarmentError, match=reason):
        check_garment(tmp_path / name, template, template)


def test_the_table_has_a_row_a_check(shirt, template):
    checked = check_mesh(*shirt(), template, template)
    lines = verdict_table(checked.verdicts).splitlines()
    assert len(lines) == 2 + len(CHECKS)
    assert all(line.startswith(f"| {check} | ok |") for line, check in zip(lines[2:], CHECKS))
