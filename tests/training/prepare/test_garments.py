"""The shipped garments, and the script that makes them."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

GARMENT_FOLDER = Path(__file__).parents[3] / "training" / "garments"
OPENINGS = {"tshirt": 4, "longsleeve": 4, "dress": 4, "trousers": 3, "skirt": 2}
VERTEX_COUNTS = {"tshirt": 3930, "longsleeve": 5072, "dress": 6438, "trousers": 4963, "skirt": 2989}
EDGE_LENGTH = 0.015
CONTACT_OFFSET = 0.003

each_garment = pytest.mark.parametrize("name", OPENINGS)


def load_garment(name: str) -> trimesh.Trimesh:
    return trimesh.load(GARMENT_FOLDER / f"{name}.obj", process=False, maintain_order=True)


def edges_with_count(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Undirected edges (e, 2) and the number of triangles at each (e,)."""
    return np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)


def opening_loops(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    edges, count = edges_with_count(mesh)
    return [np.array(list(loop)) for loop in trimesh.graph.connected_components(edges[count == 1])]


def capped(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The garment with every opening closed by a fan around its centre."""
    vertices, faces = list(mesh.vertices), list(mesh.faces)
    directed = {tuple(edge) for edge in mesh.edges.tolist()}
    for loop in opening_loops(mesh):
        members = set(loop.tolist())
        vertices.append(mesh.vertices[loop].mean(axis=0))
        for start, end in directed:
            if start in members and end in members and (end, start) not in directed:
                faces.append([end, start, len(vertices) - 1])
    return trimesh.Trimesh(vertices, faces, process=False)


@each_garment
def test_is_one_manifold_sheet(name):
    """Every edge has one or two triangles, every vertex one fan of them, and all hang together."""
    mesh = load_garment(name)
    edges, count = edges_with_count(mesh)
    assert set(count) == {1, 2}
    boundary_degree = np.bincount(edges[count == 1].ravel(), minlength=len(mesh.vertices))
    assert set(boundary_degree) == {0, 2}
    assert mesh.body_count == 1
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert capped(mesh).is_watertight
    assert len(mesh.vertices) - len(edges) + len(mesh.faces) == 2 - OPENINGS[name]  # Euler: a sphere with holes


@each_garment
def test_has_its_openings(name):
    assert len(opening_loops(load_garment(name))) == OPENINGS[name]


@each_garment
def test_faces_outwards(name):
    mesh = load_garment(name)
    assert mesh.is_winding_consistent
    assert capped(mesh).volume > 0.01


@each_garment
def test_triangles_are_even(name):
    """Edges keep to the edge length, no triangle is degenerate, and no fold or spike stands out."""
    mesh = load_garment(name)
    assert abs(len(mesh.vertices) / VERTEX_COUNTS[name] - 1) < 0.02
    lengths = mesh.edges_unique_length
    assert lengths.mean() == pytest.approx(EDGE_LENGTH, rel=0.03)
    assert lengths.min() > 0.3 * EDGE_LENGTH
    assert lengths.max() < 2.0 * EDGE_LENGTH
    assert mesh.area_faces.min() > 1e-5
    assert np.degrees(mesh.face_angles.min()) > 10
    bend = np.degrees(mesh.face_adjacency_angles)
    assert (bend > 45).mean() < 2e-3  # armpits and crotch only
    assert bend.max() < 135


@each_garment
def test_is_in_the_root_frame(name):
    """Metres, left and right alike, and around the root or the chest above it."""
    low, high = load_garment(name).bounds
    assert -0.3 < low[0] < 0 < high[0] < 0.3
    assert low[1] == pytest.approx(-high[1], abs=0.01)
    assert (low[2] < -0.05) and (high[2] > 0.04) and (high[2] - low[2] < 1.0)


@each_garment
def test_clears_the_shipped_body(name):
    """No vertex is in contact with the body that the run time ships for these garments."""
    from physkin_core.avatar.body_model import load_body_model

    model = load_body_model()
    body = trimesh.Trimesh(model.vertices(model.garment_body), model.faces, process=False)
    vertices = load_garment(name).vertices
    closest, distance, triangle = trimesh.proximity.closest_point(body, vertices)
    assert distance.min() >= CONTACT_OFFSET
    assert (np.einsum("nd,nd->n", vertices - closest, body.face_normals[triangle]) > 0).all()


@pytest.fixture(scope="module")
def construction():
    pytest.importorskip("gpytoolbox", reason="garments are made with gpytoolbox, in the extra [data]")
    from physkin_training.prepare import garment_construction

    return garment_construction


@pytest.fixture(scope="module")
def prepare_garments(construction):
    pytest.importorskip("torch", reason="the garment body comes from anny, which needs torch")
    from physkin_training.prepare import garments as prepare_garments

    return prepare_garments


@pytest.fixture
def tube(construction):
    """Open cylinder of radius 0.1 m and height 0.2 m around the Z axis, 32 by 9 vertices."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 32, endpoint=False), np.linspace(0, 0.2, 9))
    vertices = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), height], axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(9, 32)
    lower, upper = index[:-1].ravel(), index[1:].ravel()
    lower_next, upper_next = np.roll(index[:-1], -1, 1).ravel(), np.roll(index[1:], -1, 1).ravel()
    faces = np.concatenate([np.stack([lower, lower_next, upper], 1), np.stack([lower_next, upper_next, upper], 1)])
    return construction.Shell(vertices, faces, np.zeros((len(vertices), 2)))


def test_clip_cuts_along_the_zero_of_a_linear_field(construction, tube):
    field = 0.13 - tube.vertices[:, 2]
    cut = construction.clip(tube, field)
    mesh = trimesh.Trimesh(cut.vertices, cut.faces, process=False)
    whole = trimesh.Trimesh(tube.vertices, tube.faces, process=False)
    assert cut.vertices[:, 2].max() == pytest.approx(0.13)
    assert mesh.area == pytest.approx(whole.area * 0.13 / 0.2)
    assert mesh.is_winding_consistent and mesh.body_count == 1


def test_boundary_loops_follow_the_winding(construction, tube):
    loops = construction.boundary_loops(tube.faces)
    assert sorted(len(loop) for loop in loops) == [32, 32]
    directed = {tuple(edge) for edge in trimesh.Trimesh(tube.vertices, tube.faces, process=False).edges.tolist()}
    assert all(pair in directed for loop in loops for pair in zip(loop.tolist(), np.roll(loop, -1).tolist()))


def test_boundary_loops_reject_loops_that_touch(construction):
    with pytest.raises(ValueError, match="1 vertices lie on two stretches of boundary"):
        construction.boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))


def test_loft_clears_the_body_below(construction, tube):
    """The loft of a narrow tube widens over a body that is wider than it, by ease and flare, and faces outwards."""
    body = trimesh.creation.cylinder(radius=0.15, height=1.0, sections=200).vertices
    body = np.concatenate([body + [0, 0, shift] for shift in np.linspace(-0.6, 0.4, 50)])
    bottom = min(construction.boundary_loops(tube.faces), key=lambda loop: tube.vertices[loop, 2].mean())
    heights = np.array([-0.1, -0.2])
    lofted = construction.loft(tube, bottom, heights, body, ease=0.01, flare=0.5)
    for height in heights:
        ring = lofted.vertices[np.isclose(lofted.vertices[:, 2], height)]
        assert np.hypot(ring[:, 0], ring[:, 1]) == pytest.approx(0.16 - 0.5 * height, abs=1e-3)
    mesh = trimesh.Trimesh(lofted.vertices, lofted.faces, process=False)
    assert mesh.is_winding_consistent
    assert capped(mesh).volume > 0


def test_fair_removes_noise_and_keeps_shape_and_hem(construction, tube):
    vertices = tube.vertices.copy()
    vertices[:, :2] *= 1 + 0.02 * np.random.default_rng(0).standard_normal((len(vertices), 1))
    faired = construction.fair(vertices, tube.faces)
    noise, left = (np.hypot(*points[:, :2].T) - 0.1 for points in (vertices, faired))
    assert left.std() < 0.4 * noise.std()
    assert abs(left.mean()) < 2e-3
    hem = np.flatnonzero(tube.vertices[:, 2] == 0)
    assert faired[hem, 2] == pytest.approx(np.zeros(len(hem)), abs=1e-12)


def test_push_out_stops_at_the_clearance(construction):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    surface = construction.BodySurface(ball.vertices, ball.faces)
    points = np.random.default_rng(0).standard_normal((200, 3))
    points *= np.linspace(0.05, 0.2, 200)[:, None] / np.linalg.norm(points, axis=1, keepdims=True)
    pushed = surface.push_out(points, 0.004)
    distance, outward = surface.signed_distance(pushed)
    assert distance.min() == pytest.approx(0.004, abs=1e-6)
    assert np.linalg.norm(outward, axis=1) == pytest.approx(1.0)
    clear = surface.signed_distance(points)[0] > 0.004
    assert np.array_equal(pushed[clear], points[clear])


@pytest.fixture
def no_body(prepare_garments):
    empty = np.zeros((0, 3))
    return prepare_garments.TemplateBody(empty, empty, empty, np.zeros((0, 2)), {})


def test_unknown_garment_is_rejected(prepare_garments, no_body):
    with pytest.raises(ValueError, match="unknown garment 'cape'; known garments: tshirt, longsleeve, dress"):
        prepare_garments.prepare_garment("cape", no_body)


@pytest.mark.parametrize("edge_length", [0.0, 0.5, float("nan")])
def test_edge_length_out_of_range_is_rejected(prepare_garments, no_body, edge_length):
    with pytest.raises(ValueError, match=r"edge length .* is outside \[0.008, 0.03\] m"):
        prepare_garments.prepare_garment("tshirt", no_body, edge_length=edge_length)


def test_command_line_names_the_known_garments(prepare_garments, capsys):
    with pytest.raises(SystemExit):
        prepare_garments.main(["--names", "cape"])
    assert "longsleeve" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda vertices, faces: (vertices, faces[np.arange(len(faces)) != 3000]), "3 openings, 2 wanted"),
        (lambda vertices, faces: (vertices, faces[:, ::-1]), "triangles facing out"),
        (lambda vertices, faces: (vertices * [0.1, 0.1, 1], faces), "m clearance"),
        (lambda vertices, faces: (vertices, np.concatenate([faces, faces[:1]])), "not manifold"),
        (lambda vertices, faces: (vertices, np.concatenate([faces[:1, ::-1], faces[1:]])), "consistently wound"),
    ],
    ids=["hole", "inside out", "in contact", "doubled triangle", "flipped triangle"],
)
def test_check_garment_rejects(prepare_garments, spoil, message):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    ball.apply_translation([0, 0, -0.1])
    surface = prepare_garments.BodySurface(ball.vertices, ball.faces)
    mesh = load_garment("skirt")
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    prepare_garments.check_garment("skirt", vertices, faces, surface)
    with pytest.raises(RuntimeError, match=message):
        prepare_garments.check_garment("skirt", *spoil(vertices, faces), surface)


@pytest.fixture(scope="module")
def template_body(prepare_garments):
    pytest.importorskip("anny", reason="garments are made around anny's body, in the extra [data]")
    return prepare_garments.load_template_body()


@pytest.mark.slow
@each_garment
def test_script_makes_the_shipped_garment(prepare_garments, template_body, name):
    """Regenerating gives the shipped surface; where vertices lie on it may differ between machines."""
    vertices, faces = prepare_garments.prepare_garment(name, template_body)
    shipped = load_garment(name)
    assert abs(len(vertices) / len(shipped.vertices) - 1) < 0.02
    for points, surface in (
        (vertices, shipped),
        (shipped.vertices, trimesh.Trimesh(vertices, faces, process=False)),
    ):
        distance = trimesh.proximity.closest_point(surface, points)[1]
        assert distance.mean() < 5e-4
        assert distance.max() < 0.015


@pytest.mark.slow
@each_garment
def test_every_vertex_clears_the_body_it_was_made_for(construction, template_body, name):
    surface = construction.BodySurface(template_body.vertices, template_body.body_faces)
    assert surface.signed_distance(np.array(load_garment(name).vertices))[0].min() >= CONTACT_OFFSET


@pytest.mark.slow
def test_another_edge_length_is_possible(prepare_garments, template_body):
    vertices, faces = prepare_garments.prepare_garment("tshirt", template_body, edge_length=0.03)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.edges_unique_length.mean() == pytest.approx(0.03, rel=0.1)
