"""The shipped garments, and the script that makes them."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from random_models import tube

from physkin_training.fit_garment.mesh_repair import boundary_loops

GARMENT_FOLDER = Path(__file__).parents[2] / "training" / "garments"
VERTEX_COUNTS = {"tshirt": 3930, "longsleeve": 5072, "dress": 6438, "trousers": 4963, "skirt": 2989}
EDGE_LENGTH = 0.015
each_garment = pytest.mark.parametrize("name", VERTEX_COUNTS)


def load_garment(name: str) -> trimesh.Trimesh:
    return trimesh.load(GARMENT_FOLDER / f"{name}.obj", process=False, maintain_order=True)


@each_garment
def test_triangles_are_even(name):
    """Edges keep to the edge length, no triangle is degenerate, and no fold or spike stands out; left is as right.

    The checks of fit-garment, which all shipped garments pass unchanged, see to the rest.
    """
    mesh = load_garment(name)
    assert abs(len(mesh.vertices) / VERTEX_COUNTS[name] - 1) < 0.02
    lengths = mesh.edges_unique_length
    assert lengths.mean() == pytest.approx(EDGE_LENGTH, rel=0.03)
    assert lengths.min() > 0.3 * EDGE_LENGTH and lengths.max() < 2.0 * EDGE_LENGTH
    assert mesh.area_faces.min() > 1e-5 and np.degrees(mesh.face_angles.min()) > 10
    assert mesh.bounds[0, 1] == pytest.approx(-mesh.bounds[1, 1], abs=0.01)
    bend = np.degrees(mesh.face_adjacency_angles)
    assert (bend > 45).mean() < 2e-3 and bend.max() < 135  # armpits and crotch only


@pytest.fixture(scope="module")
def construction():
    pytest.importorskip("gpytoolbox", reason="garments are made with gpytoolbox, in the extra [data]")
    from physkin_prepare import garment_construction

    return garment_construction


@pytest.fixture(scope="module")
def prepare_garments(construction):
    pytest.importorskip("torch", reason="the garment body comes from anny, which needs torch")
    from physkin_prepare import garments as prepare_garments

    return prepare_garments


@pytest.fixture
def shell(construction):
    """Open cylinder of radius 0.1 m and height 0.2 m around the Z axis, 32 by 9 vertices."""
    cylinder = tube(rings=9, segments=32, radius=0.1, height=0.2)
    vertices = cylinder.vertices - [0, 0, cylinder.vertices[:, 2].min()]
    return construction.Shell(vertices, cylinder.faces, np.zeros((len(vertices), 2)))


def test_clip_cuts_along_the_zero_of_a_linear_field(construction, shell):
    field = 0.13 - shell.vertices[:, 2]
    cut = construction.clip(shell, field)
    mesh = trimesh.Trimesh(cut.vertices, cut.faces, process=False)
    whole = trimesh.Trimesh(shell.vertices, shell.faces, process=False)
    assert cut.vertices[:, 2].max() == pytest.approx(0.13)
    assert mesh.area == pytest.approx(whole.area * 0.13 / 0.2)
    assert mesh.is_winding_consistent and mesh.body_count == 1


def test_boundary_loops_follow_the_winding(shell):
    loops = boundary_loops(shell.faces)
    assert sorted(len(loop) for loop in loops) == [32, 32]
    directed = {tuple(edge) for edge in trimesh.Trimesh(shell.vertices, shell.faces, process=False).edges.tolist()}
    assert all(pair in directed for loop in loops for pair in zip(loop.tolist(), np.roll(loop, -1).tolist()))


def test_boundary_loops_reject_loops_that_touch():
    with pytest.raises(ValueError, match="1 vertices lie on two stretches of boundary"):
        boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))


@pytest.mark.parametrize(
    ("name", "edge_length", "named"),
    [("cape", 0.015, "cape"), ("tshirt", 0.0, "0.0 m"), ("tshirt", 0.5, "0.5 m"), ("tshirt", float("nan"), "nan m")],
)
def test_impossible_requests_are_rejected(prepare_garments, name, edge_length, named):
    with pytest.raises(ValueError, match=named):
        prepare_garments.prepare_garment(name, None, edge_length=edge_length)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [(lambda faces: np.delete(faces, 3000, axis=0), "3 openings, 2 wanted"), (lambda faces: faces[:, ::-1], "winding")],
    ids=["hole", "inside out"],
)
def test_a_garment_that_needs_repair_is_not_written(prepare_garments, spoil, message):
    mesh = load_garment("skirt")
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    prepare_garments.check_made("skirt", vertices, faces)
    with pytest.raises(RuntimeError, match=message):
        prepare_garments.check_made("skirt", vertices, spoil(faces))


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
