"""Stitches and hems: where they are on the flat cloth, and that nothing of them is draped."""

import io

import numpy as np
import pytest

from physkin_core.mesh.finishing import Finish, stitching, turned_up
from physkin_core.mesh.surfaces import Picture, Surface
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.pictures.picture import Mesh
from physkin_core.pictures.picture_paint import painted
from physkin_core.pictures.picture_scene import view_of
from tests.random_models import sewn_tube

WIDTH, HEIGHT, LIFT = 0.6, 0.2, 3e-4


@pytest.fixture(scope="module")
def tube() -> Garment:
    """Two panels, sewn to each other at both sides, open above and below."""
    return sewn_tube(columns=48, rings=17, width=WIDTH, height=HEIGHT)


def places_by_hand(tube: Garment, finish: Finish) -> np.ndarray:
    """(k, 3, 2) on the flat cloth."""
    return tube.panel_places[tube.panel_faces[finish.of]]


def test_hems_are_told_from_seams(tube):
    """Along a hem places are how far along it and how far from it; faces near none are left out."""
    lines = stitching(tube, LIFT)
    flat = places_by_hand(tube, lines["hems"])
    from_edge = np.minimum(flat[..., 1], HEIGHT - flat[..., 1])
    np.testing.assert_allclose(lines["hems"].places[..., 1], from_edge, atol=1e-9)
    steps = np.diff(lines["hems"].places[..., 0], axis=1)
    np.testing.assert_allclose(np.abs(steps), np.abs(np.diff(flat[..., 0], axis=1)), atol=1e-9)
    assert from_edge.min(axis=1).max() < 0.034
    both = [lines["seams"], lines["felled"]]
    assert sum(len(each.faces) for each in both) > 0
    for each in both:
        flat = places_by_hand(tube, each)
        across = flat[..., 0] - (WIDTH + 0.1) * (flat[..., 0].min(axis=1, keepdims=True) > WIDTH)
        np.testing.assert_allclose(each.places[..., 1], np.minimum(across, WIDTH - across), atol=1e-9)


def test_stitches_lie_on_the_cloth(tube):
    lines = stitching(tube, LIFT)
    normals = vertex_normals(tube.vertices, tube.faces)
    placed = lines["hems"].placed(tube.vertices, normals)
    np.testing.assert_allclose(placed, (tube.vertices + LIFT * normals)[lines["hems"].vertices])
    np.testing.assert_array_equal(lines["hems"].vertices[lines["hems"].faces], tube.faces[lines["hems"].of])
    cloud = np.concatenate([tube.vertices, normals], axis=1)
    np.testing.assert_allclose(lines["hems"].on(cloud)[:, :3], placed, atol=1e-6)


def test_hems_are_turned_up_with_an_edge(tube):
    """The inner layer looks inwards and is closed to the outer one all along the openings."""
    hem = turned_up(tube, 0.03, 0.002)
    normals = vertex_normals(tube.vertices, tube.faces)
    points = hem.placed(tube.vertices, normals)
    assert set(np.unique(hem.above)) == {-0.002, 0.0}
    inner = hem.above[hem.faces] < 0
    corners = points[hem.faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ki,ki->k", facing, normals[tube.faces[hem.of, 0]])[inner.all(axis=1)] < 0).all()
    sides = np.sort(np.concatenate([hem.faces[:, [0, 1]], hem.faces[:, [1, 2]], hem.faces[:, [2, 0]]]), axis=1)
    sides, count = np.unique(sides, axis=0, return_counts=True)
    assert count.max() == 2
    loose = sides[count == 1]
    height = tube.vertices[:, 2][hem.vertices]
    along_rim = (hem.above[loose] == 0).all(axis=1)
    at_edge = np.isclose(height[loose], tube.vertices[:, 2].min()) | np.isclose(
        height[loose], tube.vertices[:, 2].max()
    )
    assert at_edge[along_rim].all() and not at_edge[~along_rim].all(axis=1).any()


def test_of_some_faces_only_their_finish_is_left(tube):
    chosen = np.arange(len(tube.faces)) % 2 == 0
    used = np.unique(tube.faces[chosen])
    whole = stitching(tube, LIFT)["hems"]
    part = whole.of_faces(chosen, tube.faces)
    assert 0 < len(part.faces) < len(whole.faces)
    np.testing.assert_array_equal(used[part.vertices[part.faces]], tube.faces[chosen][part.of])


def test_paint_is_seen_where_the_cloth_is_and_nowhere_else():
    """A red square on half of what is seen, and one that is hidden behind it."""
    pil = pytest.importorskip("PIL.Image", reason="needs pillow: pip install 'physkin[view]'")
    buffer = io.BytesIO()
    pil.new("RGBA", (4, 4), (255, 0, 0, 255)).save(buffer, format="PNG")
    red = Surface(
        "red", (1.0, 1.0, 1.0), np.arange(2), Picture("red.png", buffer.getvalue(), "image/png"), blended=True
    )
    view = view_of(np.array([[-0.1, -0.5, -0.5], [0.1, 0.5, 0.5]]), (40, 40), 0, 0, 5.0)
    corners = np.array([[0.0, -0.4, -0.4], [0, 0, -0.4], [0, 0, 0.4], [0, -0.4, 0.4]])
    faces, ahead = np.array([[0, 1, 2], [0, 2, 3]]), np.tile([1.0, 0, 0], (4, 1))
    rows, columns = np.mgrid[0:40, 0:40] + 0.5
    positions = np.stack([0 * rows, (columns - 20) * view.pixel, (20 - rows) * view.pixel], axis=-1)
    grey = np.full((40, 40, 3), 0.4)
    for behind, normals, seen in ((0.0, ahead, True), (0.1, ahead, False), (0.0, -ahead, False)):
        mesh = Mesh(corners - [behind, 0, 0], faces, surface=red, places=corners[faces][..., 1:], normals=normals)
        found = painted(grey, np.full_like(grey, 0.2), positions, view, mesh, gain=0.5)
        covered = (found != grey).any(axis=-1)
        pixels, _ = view.pixels(corners)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        wanted = (columns > low[0]) & (columns < high[0]) & (rows > low[1]) & (rows < high[1])
        np.testing.assert_array_equal(covered, wanted & seen)
        np.testing.assert_allclose(found[covered], np.tile([1.0, 0, 0], (covered.sum(), 1)))  # light of 2, 0.5 of it
