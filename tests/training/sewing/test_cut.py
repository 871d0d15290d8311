"""Panels as triangles: even, alike on both sides of a stitch, and laid out without touching."""

from __future__ import annotations

import numpy as np
import pytest
from training.sewing.patterns import buttons, panel, tube_skirt, written

pytest.importorskip("torch")
from physkin_training.sewing.cut import BETWEEN_PANELS, BOLT, cut
from physkin_training.sewing.pattern import PatternError, load_pattern


@pytest.fixture(scope="module")
def skirt(tmp_path_factory):
    pattern = tube_skirt(gather=1.2)
    pattern["pattern"]["panels"]["front"]["edges"][0]["curvature"] = {"type": "quadratic", "params": [[0.5, 0.2]]}
    return load_pattern(written(tmp_path_factory.mktemp("cut"), pattern))


def areas_and_sides(mesh):
    corners = mesh.places[mesh.faces]
    first, second = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    return (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2, np.linalg.norm(
        corners - np.roll(corners, -1, axis=1), axis=2
    )


@pytest.mark.parametrize("edge_length", [0.02, 0.04])
def test_even_triangles_fill_the_panels(skirt, edge_length):
    mesh = cut(skirt, edge_length)
    areas, sides = areas_and_sides(mesh)
    for index, name in enumerate(mesh.names):
        outline = np.concatenate([edge.curve[:-1] for edge in skirt.panels[name].edges])
        following = np.roll(outline, -1, axis=0)
        area = (outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum() / 2
        assert areas[mesh.panel == index].sum() == pytest.approx(area, rel=2e-2)
    assert areas.min() > 0 and sides.mean() == pytest.approx(edge_length, rel=0.08)
    assert (4 * np.sqrt(3) * areas / (sides**2).sum(axis=1)).min() > 0.4, "no slivers"


def test_both_sides_of_a_stitch(skirt):
    mesh = cut(skirt, 0.03)
    front, back = (mesh.seams[:, side] for side in range(2))
    assert (
        len(mesh.seams) == 2 * (round(55 / 3) + 1)
        and (mesh.hung[front, 0] > 0).all()
        and (mesh.hung[back, 0] < 0).all()
    )
    np.testing.assert_allclose(mesh.hung[front, 1], mesh.hung[back, 1], atol=1e-12)
    np.testing.assert_allclose(1.2 * (mesh.hung[front, 2] - 0.5), mesh.hung[back, 2] - 0.5, atol=1e-12)


def test_points_of_closures_are_vertices(tmp_path):
    """Exactly, and the triangles about them are as even as elsewhere."""
    pattern = tube_skirt()
    pattern["pattern"]["closures"] = buttons(("back", 1.3, 47, "front", 58.9, 31.7), ("front", 20.1, 20, "back", 30, 2))
    mesh = cut(load_pattern(written(tmp_path, pattern)), 0.02)
    assert mesh.threads.shape == (2, 2)
    wanted = [[[-0.25, -0.287, 0.97], [0.25, 0.289, 0.817]], [[0.25, -0.099, 0.7], [-0.25, 0.0, 0.52]]]
    np.testing.assert_allclose(mesh.hung[mesh.threads], wanted, atol=1e-12)
    areas, sides = areas_and_sides(mesh)
    assert areas.min() > 0 and (4 * np.sqrt(3) * areas / (sides**2).sum(axis=1)).min() > 0.4, "no slivers"


def test_panels_lie_beside_each_other_on_the_bolt(skirt):
    mesh = cut(skirt, 0.03)
    boxes = []
    for index in range(len(mesh.names)):
        own = mesh.places[np.unique(mesh.faces[mesh.panel == index])]
        boxes.append((own.min(axis=0), own.max(axis=0)))
    (low, high), (other_low, other_high) = boxes
    assert ((low >= other_high + 0.9 * BETWEEN_PANELS) | (other_low >= high + 0.9 * BETWEEN_PANELS)).any()
    assert np.max(mesh.places[:, 0]) <= BOLT and mesh.places.min() >= 0


def test_refused(skirt, tmp_path):
    with pytest.raises(PatternError, match="edge length 0.001 m, allowed are 0.006 to 0.04 m"):
        cut(skirt, 0.001)
    for point, message in (
        ((61, 20), r"panel 'front': the closure at \(0.610, 0.200\) m is outside it; allowed are points inside, 5 mm"),
        ((59.6, 20), "is 4.0 mm from its outline"),
        ((20.3, 20), "is 3.0 mm from another one"),
    ):
        pattern = tube_skirt()
        pattern["pattern"]["closures"] = buttons(("front", *point, "back", 30, 20), ("front", 20, 20, "back", 30, 10))
        with pytest.raises(PatternError, match=message):
            cut(load_pattern(written(tmp_path, pattern)), 0.02)
    slit = panel([[0, 0], [30, 0], [30, 40], [15.2, 40], [15.0, 1], [14.8, 27], [0, 27]])
    pattern = {"pattern": {"panels": {"slit": slit}, "stitches": []}, "properties": {"units_in_meter": 100}}
    with pytest.raises(PatternError, match="panel 'slit' is too narrow at .* give a shorter edge length"):
        cut(load_pattern(written(tmp_path, pattern)), 0.04)
