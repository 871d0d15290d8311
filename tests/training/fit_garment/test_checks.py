"""Each defect of a garment mesh, made on purpose, is found; what can be repaired is, and passes afterwards."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from random_models import cape, opened_in_front, tube, undone
from training.small_runs import mesh_of

from physkin_core import load_body_model, load_garment
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.mesh.mesh_file import MeshFile, read_mesh
from physkin_core.model.garment import GarmentError
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.fit_garment.checks import CheckedGarment, check_garment, write_garment
from physkin_training.fit_garment.file_objects import chosen_objects
from physkin_training.fit_garment.fitting import CLEARANCE, onto_body
from physkin_training.fit_garment.verdicts import in_lines

GARMENTS = Path(__file__).parents[3] / "training" / "garments"
Y_UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
CHECKS = [
    "triangles", "units", "orientation", "position", "duplicates", "one layer", "seams", "manifold", "pieces",
    "winding", "openings", "upright", "scale", "edge length", "pose", "overlap", "body", "self-intersection",
    "flat rest shape",
]  # fmt: skip
ONE_OF_A_KIND = ("longsleeve", "skirt")
FOLDED = ("longsleeve", "shorts", "turtleneck")


@pytest.fixture(scope="module")
def shirt():
    """The shipped tank top: vertices (n, 3) and faces (f, 3), fresh copies on every use."""
    garment = load_garment(GARMENTS / "tanktop.obj")
    return lambda: (garment.vertices.copy(), garment.faces.copy())


def outcomes(checked: CheckedGarment) -> dict[str, str]:
    """Outcome by check, of those that are not ok."""
    return {verdict.check: verdict.outcome for verdict in checked.verdicts if verdict.outcome != "ok"}


def found(checked: CheckedGarment, check: str) -> str:
    return next(verdict.found for verdict in checked.verdicts if verdict.check == check)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ONE_OF_A_KIND else pytest.mark.slow)
        for name in sorted(path.stem for path in GARMENTS.glob("*.obj"))
    ],
)
def test_a_shipped_garment_passes_everything_unchanged(name, template, tmp_path):
    """Every check is named; the written mesh is the one that was read. Where sleeves and
    legs are folded, a few edges go through a face."""
    checked = check_garment(read_mesh(GARMENTS / f"{name}.obj"), template, template)
    wanted = dict.fromkeys(CHECKS, "ok") | ({"self-intersection": "warning"} if name in FOLDED else {})
    assert [(verdict.check, verdict.outcome) for verdict in checked.verdicts] == list(wanted.items())
    *others, fine = in_lines(checked.verdicts).splitlines()
    assert fine == "ok: " + ", ".join(check for check, outcome in wanted.items() if outcome == "ok")
    assert [line.split(": ")[:2] for line in others] == ([["warning", "self-intersection"]] if name in FOLDED else [])
    garment = load_garment(GARMENTS / f"{name}.obj")
    if name in FOLDED:
        through = re.match(r"(\d+) edges go through a face", found(checked, "self-intersection"))
        assert int(through[1]) < 0.01 * len(garment.edges)
    np.testing.assert_array_equal(checked.vertices, garment.vertices)
    write_garment(tmp_path / "again.obj", checked)
    again = load_garment(tmp_path / "again.obj")
    np.testing.assert_allclose(again.vertices, checked.vertices, atol=1e-7)
    np.testing.assert_array_equal(again.faces, garment.faces)


def inches_y_up_wound_at_random(v, f):
    return v @ Y_UP.T / 0.0254, np.where((np.arange(len(f)) % 3 == 0)[:, None], f[:, ::-1], f)


def centimetres_on_the_floor_without_edges(v, f):
    v = 100 * (v + [0, 0, 0.9141])
    soup = v[f].reshape(-1, 3), np.arange(f.size).reshape(-1, 3)
    return soup[0], np.concatenate([soup[1], soup[1][:3], [[5, 5, 9]]])


def backwards_inside_out_with_a_fin_and_a_button(v, f):
    fin, disc = v[f[100, 0]] + [0.0, 0.004, 0.004], v[f[2000]] + 0.008 * np.array([1.0, 0, 0])
    faces = np.concatenate([f, [[*f[100, :2], len(v)]], len(v) + 1 + np.arange(3)[None]])
    return np.concatenate([v, fin[None], disc]) * [-1, -1, 1], faces[:, ::-1].copy()


def dented(v, f):
    chest = np.linalg.norm(v - [0.13, 0.0, 0.35], axis=1)
    return v - 0.04 * np.exp(-((chest / 0.06) ** 2))[:, None] * [1, 0, 0], f


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (inches_y_up_wound_at_random, "units: inches | orientation: Y up, Z forward | winding: 3212 faces turned"),
        (
            centimetres_on_the_floor_without_edges,
            "units: centimetres | position: moved by (0.000, 0.000, -0.914) | "
            "duplicates: 23973 duplicate vertices, 4 degenerate or repeated",
        ),
        (
            backwards_inside_out_with_a_fin_and_a_button,
            "orientation: Z up, -X forward | manifold: 1 faces at edges | pieces: 1 scraps | winding: inside out",
        ),
        (dented, "overlap: vertices in the body"),
    ],
)
def test_defects_are_found_and_repaired(spoil, words, shirt, template):
    words = dict(part.split(": ", 1) for part in words.split(" | "))
    checked = check_garment(mesh_of(*spoil(*shirt())), template, template)
    assert outcomes(checked) == dict.fromkeys(words, "repaired")
    assert all(text in found(checked, check) for check, text in words.items())
    again = check_garment(mesh_of(checked.vertices, checked.faces), template, template)
    assert outcomes(again) == {}
    vertices, _ = shirt()
    assert checked.vertices.shape == vertices.shape
    if spoil is dented:
        surface = BodySurface(template.vertices, template.faces)
        assert surface.closest(checked.vertices).distance.min() >= CLEARANCE - 1e-5
        assert surface.closest(spoil(*shirt())[0]).distance.min() < -0.005, "the test must begin inside the body"
    else:
        gap = np.linalg.norm(checked.vertices[:, None] - vertices[::97], axis=-1).min(axis=0)
        assert gap.max() < 2e-4


def test_of_cloth_with_a_thickness_the_outer_sheet_is_kept(shirt, template):
    """All of it, and no more."""
    checked = check_garment(mesh_of(*thick(*shirt())), template, template)
    assert outcomes(checked)["one layer"] == "repaired" and "a thickness" in found(checked, "one layer")
    vertices, faces = shirt()
    assert abs(len(checked.faces) - len(faces)) < 0.01 * len(faces)
    gap = np.linalg.norm(checked.vertices[::97, None] - vertices, axis=-1).min(axis=1)
    assert np.median(gap) < 1e-6 and "4 openings" in found(checked, "openings")


def test_a_mesh_from_anywhere_is_put_on_the_body(shirt, template):
    """No usual origin: the place is searched, which is warned of, and found to about a centimetre."""
    vertices, faces = shirt()
    checked = check_garment(mesh_of(1000 * (vertices @ Y_UP.T + [0.3, 0.5, -0.2]), faces), template, template)
    expected = {"units": "repaired", "orientation": "repaired", "position": "warning", "overlap": "repaired"}
    assert outcomes(checked) == expected
    assert "front and height" in found(checked, "position")
    assert np.abs(checked.vertices - vertices).max() < 0.02


def test_coarse_triangles_are_refined_on_the_same_surface(template):
    band = tube(rings=5, segments=24, radius=1.0, height=0.2)
    checked = check_garment(mesh_of(band.vertices * [0.2, 0.24, 1.0] + [0, 0, 0.1], band.faces), template, template)
    assert outcomes(checked)["edge length"] == "repaired"
    assert len(checked.faces) == 16 * len(band.faces)


def hole(v, f):
    return v, np.delete(f, 3000, axis=0)


def finer(v, f):
    long = load_garment(GARMENTS / "longsleeve.obj")
    return trimesh.remesh.subdivide(long.vertices, long.faces)


def crossing(v, f):
    """The hem of a skirt is folded up, in and out through the cloth above."""
    garment = load_garment(GARMENTS / "skirt.obj")
    v = garment.vertices.copy()
    hem, angle = v[:, 2] < v[:, 2].min() + 0.04, np.arctan2(v[:, 1], v[:, 0])
    v[hem] = v[hem] * (1 + 0.1 * np.sin(12 * angle[hem, None]) * [1, 1, 0]) + [0, 0, 0.07]
    return v, garment.faces


def too_large(v, f):
    skirt = load_garment(GARMENTS / "pencilskirt.obj")
    middle = skirt.vertices.mean(axis=0)
    return 1.18 * (skirt.vertices - middle) + middle, skirt.faces


def quarters(v, f, *, gap: float, fine: bool = False):
    """Cut in four, the cloth of each drawn back at its new boundaries by half of the gap; fine: two of them with four
    triangles for each of the others."""
    which = 2 * (v[f, 1].mean(axis=1) > 0) + (v[f, 2].mean(axis=1) > v[:, 2].mean())
    found, faces, first = [], [], 0
    for quarter in range(4):
        used, own = np.unique(f[which == quarter], return_inverse=True)
        own = own.reshape(-1, 3)
        shared = [np.isin(used, f[which == other]) for other in range(4) if other != quarter]
        at = v[used]
        rim = np.any(shared, axis=0)
        inner = np.array([at[np.setdiff1d(own[(own == k).any(axis=1)], k)].mean(axis=0) for k in np.flatnonzero(rim)])
        away = inner - at[rim]
        at[rim] += gap / 2 * away / np.linalg.norm(away, axis=1, keepdims=True)
        if fine and quarter in (0, 3):
            at, own = trimesh.remesh.subdivide(at, own)
        found, faces, first = [*found, at], [*faces, own + first], first + len(at)
    return np.concatenate(found), np.concatenate(faces)


@pytest.mark.parametrize("gap", [0.0001, 0.0005, 0.002])
@pytest.mark.parametrize("fine", [False, True])
def test_panels_that_nearly_touch_are_joined(gap, fine, shirt, template):
    """To the cloth that they were cut from; where one side has more vertices, the other gets them."""
    vertices, faces = shirt()
    checked = check_garment(mesh_of(*quarters(vertices, faces, gap=gap, fine=fine)), template, template)
    assert not checked.refused and outcomes(checked)["seams"] == "repaired"
    assert "of boundaries joined that were up to" in found(checked, "seams") and found(checked, "pieces") == "one piece"
    assert found(checked, "openings") == "4 openings"
    touching, _ = quarters(vertices, faces, gap=0.0, fine=fine)
    assert len(checked.vertices) == len(np.unique(np.round(touching, 7), axis=0)), "none is lost or left beside another"
    if not fine:
        assert len(checked.faces) == len(faces)
        away = np.linalg.norm(checked.vertices[:, None] - vertices[::97], axis=-1).min(axis=0)
        assert away.max() < gap


@pytest.mark.parametrize("gap", [0.001, 0.0025])
def test_an_open_front_drawn_edge_to_edge_stays_open(gap, template):
    """Its edges are no seam; the user learns how to make them one."""
    cardigan = opened_in_front(load_garment(GARMENTS / "longsleeve.obj"), gap=gap)
    checked = check_garment(mesh_of(cardigan.vertices, cardigan.faces), template, template)
    assert outcomes(checked)["seams"] == "warning" and len(checked.vertices) == len(cardigan.vertices)
    assert found(checked, "seams").endswith("along each other; an open front, kept; join its vertices to close it")
    assert found(checked, "openings") == "3 openings, open in front", "the wrists, and neckline, front and hem in one"


def test_a_front_that_is_open_halfway_stays_open(template):
    """As a zip that is closed up to the chest."""
    made = load_garment(GARMENTS / "longsleeve.obj")
    x, y, z = made.vertices.T
    side = made.vertices[made.faces, 1].mean(axis=1)
    half = undone(made, (np.abs(y) < 2e-3) & (x > 0.04) & (z > 0.25), side < 0, np.array([0.0, -0.001, 0.0]))
    checked = check_garment(mesh_of(half.vertices, half.faces), template, template)
    assert outcomes(checked)["seams"] == "warning" and len(checked.vertices) == len(half.vertices)
    assert found(checked, "openings") == "4 openings"


@pytest.mark.parametrize("where, gap", [("front", 0.00008), ("behind", 0.001), ("aside", 0.001)])
def test_a_seam_that_is_drawn_edge_to_edge_is_joined(where, gap, template):
    """In front where its edges touch, and elsewhere whatever the gap."""
    made = load_garment(GARMENTS / "longsleeve.obj")
    (x, y, z), (before, side, _) = made.vertices.T, made.vertices[made.faces].mean(axis=1).T
    places = np.unique(np.stack([made.faces, made.panel_faces], axis=-1).reshape(-1, 2), axis=0)
    middle, sewn = np.abs(y) < 2e-3, np.bincount(places[:, 0]) > 1
    seam, beyond, away = {
        "front": (middle & (x > 0.04), side < 0, [0, -1, 0]),
        "behind": (middle & (x < -0.04), side < 0, [0, -1, 0]),
        "aside": (sewn & (0.15 < y) & (y < 0.21) & (x < 0.022) & (z < 0.25), before < 0.015, [-1, 0, 0]),
    }[where]
    cut = undone(made, seam, beyond, gap * np.array(away))
    checked = check_garment(mesh_of(cut.vertices, cut.faces), template, template)
    assert outcomes(checked)["seams"] == "repaired" and "of boundaries joined" in found(checked, "seams")
    assert found(checked, "openings") == "4 openings" and len(checked.vertices) == len(made.vertices)


def test_what_a_pattern_leaves_open_stays_open(shirt, template):
    checked = check_garment(mesh_of(*quarters(*shirt(), gap=0.0005)), template, template, sewn=True)
    assert "4 connected pieces" in found(checked, "pieces") and "seams" not in outcomes(checked)


def test_panels_farther_apart_are_refused_with_place_and_gap(shirt, template):
    checked = check_garment(mesh_of(*quarters(*shirt(), gap=0.006)), template, template)
    assert checked.refused and checked.verdicts[-1].check == "seams"
    assert re.match(r"separate pieces run along each other, \d\.\d mm apart, at \(.*\) m", checked.verdicts[-1].found)


def in_one_file(*meshes):
    """Vertices and faces of (vertices, faces), and which of them each face is of."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = np.concatenate([faces + start for (_, faces), start in zip(meshes, starts)])
    return np.concatenate([v for v, _ in meshes]), faces, np.repeat(np.arange(len(meshes)), [len(f) for _, f in meshes])


def with_names(mesh: MeshFile, part: np.ndarray, *parts: str) -> MeshFile:
    return replace(mesh, look=replace(mesh.look, part=part, parts=parts))


@pytest.mark.parametrize("head", [True, False])
def test_a_body_beside_the_garment_is_named(head, shirt, template):
    """Closed, or as one that is open at the neck and made for nobody here. And the garment alone is taken when it is
    chosen."""
    below = template.vertices[template.faces, 2].max(axis=1) < (1.0 if head else 0.55)
    skin = template.vertices if head else template.vertices * [1.03, 1.02, 1.0]
    vertices, faces, part = in_one_file((skin, template.faces[below]), shirt())
    mesh = with_names(mesh_of(vertices, faces), part, "Avatar", "Shirt")
    last = check_garment(mesh, template, template).verdicts[-1]
    assert (last.check, last.outcome) == ("pieces", "refused")
    assert last.found == "the file holds a body ('Avatar') and a garment ('Shirt'); choose with --object NAME"
    chosen = check_garment(chosen_objects(mesh, ["Shirt"]), template, template, chosen=True)
    np.testing.assert_array_equal(chosen.vertices, check_garment(mesh_of(*shirt()), template, template).vertices)


@pytest.mark.parametrize("names", [("top", "skirt"), ()])
def test_two_garments_are_named(names, shirt, template):
    """By their objects, or by their number; both of them are taken when both are chosen. Their faces come mixed."""
    skirt = load_garment(GARMENTS / "skirt.obj")
    vertices, faces, part = in_one_file(shirt(), (skirt.vertices, skirt.faces))
    mixed = np.random.default_rng(0).permutation(len(faces))
    mesh = mesh_of(vertices, faces[mixed])
    if names:
        mesh = with_names(mesh, part[mixed], *names)
    first, second = names or ("2", "1")  # the skirt has more faces
    last = check_garment(mesh, template, template).verdicts[-1]
    assert last.check == "pieces" and f"a garment ('{first}')" in last.found and f"a garment ('{second}')" in last.found
    assert len(chosen_objects(mesh, [second]).faces) == len(skirt.faces)
    both = chosen_objects(mesh, [first, second])
    assert "2 connected pieces" in found(check_garment(both, template, template, chosen=True), "pieces")
    with pytest.raises(
        ValueError, match=f"no object 'hat' in the garment's file; it has '{names[0] if names else 1}', "
    ):
        chosen_objects(mesh, ["hat"])


def pinched_skirt(v, f):
    """Two halves that hang together at one vertex: they come apart there, and are then two pieces."""
    garment = load_garment(GARMENTS / "skirt.obj")
    left, right = ((side * garment.vertices[garment.faces, 1] > 0).all(axis=1) for side in (1, -1))
    faces = garment.faces[left | right].copy()
    faces[faces == garment.faces[left][0, 0]] = garment.faces[right][0, 0]
    return garment.vertices, faces


def closed(v, f):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.22)
    return ball.vertices * [1, 1.2, 1.5] + [0.02, 0, 0.2], ball.faces


def moebius(v, f):
    """A band about the waist with one half twist."""
    s = 160
    angle = np.linspace(0, 2 * np.pi, s, endpoint=False)
    across = np.linspace(-0.03, 0.03, 5)[:, None]
    radius = 0.22 + across * np.cos(angle / 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.1 + across * np.sin(angle / 2)], axis=-1)
    a, row = np.arange(4 * s), np.arange(4 * s) // s
    last = a % s == s - 1  # joined to the first column upside down
    b, c = np.where(last, (4 - row) * s, a + 1), np.where(last, (3 - row) * s, a + s + 1)
    return points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, a + s], 1)])


def panels(v, f):
    """Front and back of a shirt as they were cut, upright before and behind the trunk."""
    x, y = np.meshgrid(np.linspace(-0.28, 0.28, 29), np.linspace(-0.1, 0.5, 31))
    corner = (np.arange(30)[:, None] * 29 + np.arange(28)).reshape(-1)
    faces = np.concatenate([corner[:, None] + [0, 1, 30], corner[:, None] + [0, 30, 29]])
    points = [np.column_stack([np.full(x.size, away), x.ravel(), y.ravel()]) for away in (0.2, -0.2)]
    return np.concatenate(points), np.concatenate([faces, faces[:, ::-1] + x.size])


def book(v, f):
    """A third sheet along many edges."""
    third = v[f[::20]].mean(axis=1) + [0.01, 0, 0]
    return np.concatenate([v, third]), np.concatenate(
        [f, np.column_stack([f[::20, :2], len(v) + np.arange(len(third))])]
    )


def doubled(v, f):
    """A copy beside it: outer sheets come from both, in patches that are joined but for small holes."""
    return np.concatenate([v, v + [0.003, 0, 0]]), np.concatenate([f, f[:, ::-1] + len(v)])


def thick(v, f):
    """3 mm, as one solid: the sheets are joined along the openings."""
    mesh = trimesh.Trimesh(v, f, process=False)
    inner = v - 0.003 * mesh.vertex_normals
    edges = f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    a, b = edges[first[count == 1]].T
    n = len(v)
    rims = np.concatenate([np.stack([b, a, a + n], 1), np.stack([b, a + n, b + n], 1)])
    return np.concatenate([v, inner]), np.concatenate([f, f[:, ::-1] + n, rims])


WARNED = [
    (hole, "openings", "4 openings, 1 holes"),
    pytest.param(finer, "edge length", "finer than training needs", marks=pytest.mark.slow),
    (crossing, "self-intersection", "edges go through a face"),
    (too_large, "scale", "times its size it would lie closer"),
    (doubled, "openings", "4 openings, 21 holes"),
    (pinched_skirt, "pieces", "2 connected pieces"),
]
REFUSED = [
    (closed, "openings", "it is closed"),
    (panels, "openings", "2 flat pieces that are not sewn together"),
    (moebius, "winding", "only one side"),
    (lambda v, f: ((v - v.mean(0)) * [0.75, 0.75, 1] + v.mean(0), f), "overlap", "vertices in the body"),
    (lambda v, f: (1e5 * v, f), "units", "longest extent"),
    (book, "manifold", "faces at edges of three"),
    (lambda v, f: (np.where(np.arange(len(v))[:, None] == 7, np.nan, v), f), "triangles", "1 vertices have no"),
    (lambda v, f: (v, f[:0]), "triangles", "no faces"),
    (lambda v, f: (v, f + 1), "triangles", "vertices that are not there"),
]  # fmt: skip


@pytest.mark.parametrize(("spoil", "check", "words"), WARNED)
def test_what_may_be_meant_is_warned_of(spoil, check, words, shirt, template):
    checked = check_garment(mesh_of(*spoil(*shirt())), template, template)
    assert outcomes(checked)[check] == "warning" and words in found(checked, check)
    if spoil is pinched_skirt:
        assert "1 vertices that pinch" in found(checked, "manifold")


@pytest.mark.parametrize(("spoil", "check", "words"), REFUSED)
def test_what_cannot_be_repaired_is_refused(spoil, check, words, shirt, template):
    checked = check_garment(mesh_of(*spoil(*shirt())), template, template)
    last = checked.verdicts[-1]
    assert checked.refused and (last.check, last.outcome) == (check, "refused") and words in last.found


def test_a_loose_garment_is_not_upside_down(shirt, template):
    """Its neckline leaves the neck where it lies, yet settles on the shoulders; turned over, it is found to be so."""
    vertices, faces = shirt()
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    checked = check_garment(mesh_of(1.18 * (vertices - middle) + middle, faces), template, template)
    assert not checked.refused and outcomes(checked)["scale"] == "warning"
    checked = check_garment(mesh_of((vertices - middle) * [1.18, -1.18, -1.18] + middle, faces), template, template)
    assert checked.refused and checked.verdicts[-1].check == "upright"


@pytest.mark.slow
def test_a_cape_may_be_far_from_the_body_where_it_hangs_from_the_shoulders(template):
    """The same cloth 35 cm higher lies nowhere."""
    cloth = cape(rings=62, segments=124)
    checked = check_garment(mesh_of(cloth.vertices, cloth.faces), template, template)
    assert not checked.refused and "mean distance to the body 12" in found(checked, "position")
    assert outcomes(checked).keys() <= {"overlap"}
    checked = check_garment(mesh_of(cloth.vertices + [0, 0, 0.35], cloth.faces), template, template)
    assert checked.refused and checked.verdicts[-1].check == "position"


def test_a_garment_of_another_body_is_moved_over(shirt, template):
    """There and back again is nearly the same; what was made on a tall body fits the template, with a warning."""
    body_model = load_body_model()
    tallest = max(body_model.held_out_bodies, key=lambda c: np.ptp(body_model.vertices(c)[:, 2]))
    tall = avatar_from_body(body_model, tallest)
    vertices, faces = shirt()
    there = onto_body(vertices, template, tall)
    assert np.linalg.norm(there - vertices, axis=1).max() > 0.02
    assert np.linalg.norm(onto_body(there, tall, template) - vertices, axis=1).mean() < 0.005
    on_tall = BodySurface(tall.vertices, tall.faces).push_out(there, 0.005)
    checked = check_garment(mesh_of(on_tall, faces), tall, template)
    assert not checked.refused
    assert outcomes(checked)["body"] == "warning" and "another body" in found(checked, "body")
    assert np.linalg.norm(checked.vertices - vertices, axis=1).mean() < 0.02
    assert outcomes(check_garment(mesh_of(checked.vertices, checked.faces), template, template)) == {}


def test_quads_are_cut(tmp_path, template):
    ring = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    points = np.concatenate([np.stack([0.2 * np.cos(ring), 0.24 * np.sin(ring), 0 * ring + h], 1) for h in (0.1, 0.12)])
    text = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.tolist()]
    text += [f"f {k + 1} {(k + 1) % 64 + 1} {(k + 1) % 64 + 65} {k + 65}" for k in range(64)]
    (tmp_path / "quads.obj").write_text("\n".join(text))
    checked = check_garment(read_mesh(tmp_path / "quads.obj"), template, template)
    assert outcomes(checked)["triangles"] == "repaired"
    assert "128 triangles, 128 vertices, from 64 faces" in found(checked, "triangles")


@pytest.mark.parametrize(("name", "content"), [("nosuch.obj", None), ("shirt.fbx", ""), ("empty.obj", "")])
def test_a_file_without_a_mesh_is_an_error(name, content, tmp_path, template):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(GarmentError, match=name):
        check_garment(read_mesh(tmp_path / name), template, template)
