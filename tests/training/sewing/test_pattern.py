"""Sewing patterns: curves, frames and units, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from training.sewing.patterns import buttons, panel, sides, tube_skirt, written

pytest.importorskip("torch")
from physkin_training.sewing.pattern import PatternError, load_pattern

PATTERNS = Path(__file__).resolve().parents[4] / "shared" / "assets" / "patterns"


def alone(only: dict, units: float = 100) -> dict:
    return {"pattern": {"panels": {"p": only}, "stitches": []}, "properties": {"units_in_meter": units}}


def test_frames_and_units(tmp_path):
    pattern = load_pattern(written(tmp_path, tube_skirt()))
    front, back = pattern.panels["front"], pattern.panels["back"]
    corners = front.hung(np.array([edge.curve[0] for edge in front.edges]))
    np.testing.assert_allclose(
        corners, [[0.25, -0.3, 0.5], [0.25, 0.3, 0.5], [0.25, 0.3, 1.0], [0.25, -0.3, 1.0]], atol=1e-12
    )
    for each, outwards in ((front, 1.0), (back, -1.0)):
        assert np.cross(each.axes[:, 0], each.axes[:, 1]) @ [outwards, 0, 0] == pytest.approx(1.0), "seen from outside"
        loop = np.array([edge.curve[0] for edge in each.edges])
        following = np.roll(loop, -1, axis=0)
        area = (loop[:, 0] * following[:, 1] - loop[:, 1] * following[:, 0]).sum() / 2
        assert area == pytest.approx(0.3), "counter-clockwise"
    for one, other in pattern.stitches:
        ends = [pattern.panels[name].hung(pattern.panels[name].edges[edge].points(4)) for name, edge in (one, other)]
        np.testing.assert_allclose(ends[0][:, 1:], ends[1][::-1, 1:], atol=1e-12, err_msg="against its direction")


def test_a_panel_turned_about_its_place(tmp_path):
    turned = panel([[0, 0], [30, 0], [30, 20], [0, 20]], place=(10, 100, 0), turn=(0, 90, 0))
    found = load_pattern(written(tmp_path, alone(turned))).panels["p"]
    np.testing.assert_allclose(found.hung(np.array([0.3, 0.2])), [-0.3, 0.1, 1.2], atol=1e-12)


@pytest.mark.parametrize(
    "bend, length, side",
    [
        ({"type": "quadratic", "params": [[0.5, -0.4]]}, None, "out"),
        ({"type": "cubic", "params": [[0.3, -0.2], [0.7, -0.2]]}, None, "out"),
        ({"type": "circle", "params": [20.0, 0, 1]}, np.pi * 0.2, "out"),
        ({"type": "circle", "params": [20.0, 0, 0]}, np.pi * 0.2, "in"),
        ({"type": "circle", "params": [25.0, 1, 1]}, 0.25 * (2 * np.pi - 2 * np.arcsin(0.8)), "out"),
    ],
)
def test_curves(tmp_path, bend, length, side):
    """Of a lower edge that goes along the first axis: to its right is down, out of the panel."""
    square = panel([[0, 0], [40, 0], [40, 60], [0, 60]], bends={0: bend})
    edge = load_pattern(written(tmp_path, alone(square))).panels["p"].edges[0]
    np.testing.assert_allclose(edge.curve[[0, -1]], [[0, 0], [0.4, 0]], atol=1e-12)
    assert (edge.curve[1:-1, 1] < 0).all() if side == "out" else (edge.curve[1:-1, 1] > 0).all()
    if length is not None:
        assert edge.length == pytest.approx(length, rel=1e-3)
    steps = np.linalg.norm(np.diff(edge.points(16), axis=0), axis=1)
    assert steps.max() < 1.01 * steps.min(), "evenly spaced"


def crossed() -> dict:
    return alone(panel([[0, 0], [50, 50], [50, 0], [0, 40]]))


def changed(**changes) -> dict:
    pattern = tube_skirt()
    for name, value in changes.items():
        pattern["pattern"][name] = value
    return pattern


@pytest.mark.parametrize(
    "pattern, message",
    [
        ("{", "not JSON"),
        ({"pattern": {}}, "'pattern.panels': field required"),
        (crossed(), "panel 'p' crosses itself: its edges 0 and 2 do"),
        (alone(panel([[0, 0], [40, 0], [40, 60], [0, 60]]), units=1), "40 m wide|60 m wide.*another unit"),
        (alone(panel([[0, 0], [40, 0], [40, 60], [0, 60]]), units=1000), "0.06 m wide or high at 1000 units"),
        (changed(stitches=sides(("front", 1, "side", 0))), "stitch 0 is of panel 'side', which there is not"),
        (changed(stitches=sides(("front", 4, "back", 0))), "edge 4 of panel 'front', allowed are 0 to 3"),
        (
            changed(stitches=sides(("front", 1, "back", 2), ("front", 1, "back", 0))),
            "edge 1 of panel 'front' is sewn twice",
        ),
        (
            changed(stitches=sides(("front", 1, "back", 2), ("front", 0, "back", 1))),
            "stitch 1 sews edge 0 of panel 'front' to edge 1 of 'back': it would cross, as these panels hang",
        ),
        (
            changed(stitches=[[*sides(("front", 1, "back", 2))[0], "left_right"]]),
            "'pattern.stitches.0.2': input should be 'right_wrong' or none, got 'left_right'",
        ),
        (
            tube_skirt(gather=3.2),
            "edge 1 of panel 'front', 0.500 m, to edge 2 of 'back', 1.600 m: one may be at most 3",
        ),
        (alone(panel([[0, 0], [40, 0], [40, 0.05], [0, 60]])), "panel 'p', edge 1 is 0.5 mm long"),
        (changed(closures=buttons(("side", 1, 2, "back", 1, 2))), "closure 0 is of panel 'side', which there is not"),
        (changed(closures=[buttons(("front", 1, 2, "back", 1, 2))[0][:1]]), "'pattern.closures.0.1': field required"),
        (
            alone(panel([[0, 0], [40, 0], [40, 60], [0, 60]], bends={1: {"type": "circle", "params": [20, 0, 0]}})),
            "panel 'p', edge 1: a circle of radius 0.2 m is too small",
        ),
        (
            alone(panel([[0, 0], [40, 0], [40, 60], [0, 60]], bends={1: {"type": "cubic", "params": [[0.5, 0]]}})),
            "panel 'p', edge 1: a cubic curve needs 2 control points",
        ),
    ],
)
def test_refused(tmp_path, pattern, message):
    with pytest.raises(PatternError, match=message) as error:
        load_pattern(written(tmp_path, pattern))
    assert str(tmp_path / "pattern.json") in str(error.value) and "\n" not in str(error.value)


def test_an_outline_that_is_open(tmp_path):
    pattern = tube_skirt()
    pattern["pattern"]["panels"]["front"]["edges"][1]["endpoints"] = [2, 3]
    with pytest.raises(PatternError, match="panel 'front', edge 0 ends at corner 1 and the next one starts at 2"):
        load_pattern(written(tmp_path, pattern))


def drawn_backwards(pattern: dict, name: str, *, mark: bool = False) -> dict:
    """With a panel's edges in the opposite order, and its stitches to others marked as GarmentCode does then."""
    edges = pattern["pattern"]["panels"][name]["edges"]
    edges[:] = [edge | {"endpoints": edge["endpoints"][::-1]} for edge in edges[::-1]]
    for stitch in pattern["pattern"]["stitches"]:
        for side in stitch[:2]:
            if side["panel"] == name:
                side["edge"] = len(edges) - 1 - side["edge"]
                stitch += ["right_wrong"] * mark
    return pattern


def seam_ends(pattern) -> np.ndarray:
    """(stitches, 2, 2, 3) where the ends that each stitch sews together hang, in an order of their own."""
    ends = [
        [pattern.panels[name].hung(pattern.panels[name].edges[i].curve[[0, -1]]) for name, i in pair]
        for pair in pattern.stitches
    ]
    ends = np.array(ends)
    ends[:, 1] = ends[:, 1, ::-1]
    return np.array([each[:, np.argsort(each[0, :, 2])] for each in ends])


def winding(pattern) -> list[float]:
    """How far forward each panel's outside faces."""
    return [float(np.cross(*each.axes.T)[0]) for each in pattern.panels.values()]


@pytest.mark.parametrize("name", ["front", "back"])
def test_points_of_closures_go_with_their_panels(name, tmp_path):
    """The back is drawn from inside; either may be turned over."""
    closures = {"closures": buttons(("front", 5, 45, "back", 8, 40), ("back", 20, 30, "front", 50, 10))}
    pattern = changed(**closures)
    for found in (load_pattern(written(tmp_path, each)) for each in (pattern, drawn_backwards(pattern, name))):
        hung = [[found.panels[panel].hung(found.panels[panel].held[k]) for panel, k in pair] for pair in found.closures]
        wanted = [[[0.25, -0.25, 0.95], [-0.25, -0.22, 0.9]], [[-0.25, -0.1, 0.8], [0.25, 0.2, 0.6]]]
        np.testing.assert_allclose(hung, wanted, atol=1e-12)


@pytest.mark.parametrize("name", ["front", "back"])
@pytest.mark.parametrize("mark", [False, True])
def test_a_panel_drawn_in_the_wrong_direction(name, mark, tmp_path, caplog):
    """The same seams, and the same side out everywhere: with a warning, or as the marks of its seams say."""
    wanted = load_pattern(written(tmp_path, tube_skirt()))
    found = load_pattern(written(tmp_path, drawn_backwards(tube_skirt(), name, mark=mark)))
    np.testing.assert_allclose(seam_ends(found), seam_ends(wanted), atol=1e-12)
    assert winding(found) == pytest.approx(winding(wanted)) or winding(found) == pytest.approx(
        [-each for each in winding(wanted)]
    )
    assert ("is drawn in the wrong direction for its stitches" in caplog.text) is not mark
    for each in found.panels.values():
        loop = np.array([edge.curve[0] for edge in each.edges])
        following = np.roll(loop, -1, axis=0)
        assert (loop[:, 0] * following[:, 1] - loop[:, 1] * following[:, 0]).sum() > 0, "counter-clockwise"


def test_a_mark_that_would_twist_a_seam(tmp_path, caplog):
    """Of one seam of two panels alone: it is sewn as without it, which is said."""
    pattern = tube_skirt()
    pattern["pattern"]["stitches"][1].append("right_wrong")
    found = load_pattern(written(tmp_path, pattern))
    assert found.stitches == load_pattern(written(tmp_path, tube_skirt())).stitches
    assert "edge 3 of panel 'front' to edge 0 of 'back' would cross or twist if sewn start to start" in caplog.text


def test_a_seam_listed_twice_is_one(tmp_path):
    pattern = tube_skirt()
    pattern["pattern"]["stitches"] += [pattern["pattern"]["stitches"][0][::-1], pattern["pattern"]["stitches"][1]]
    assert load_pattern(written(tmp_path, pattern)).stitches == load_pattern(written(tmp_path, tube_skirt())).stitches


def test_a_curve_as_older_patterns_have_it(tmp_path):
    """Its control point by itself."""
    edges = []
    for bend in ([0.4, -0.2], {"type": "quadratic", "params": [[0.4, -0.2]]}):
        square = panel([[0, 0], [40, 0], [40, 60], [0, 60]], bends={0: bend})
        edges.append(load_pattern(written(tmp_path, alone(square))).panels["p"].edges[0].curve)
    np.testing.assert_array_equal(*edges)


@pytest.mark.skipif(not PATTERNS.exists(), reason=f"needs {PATTERNS}")
def test_patterns_of_garmentcode():
    found = {path.stem: load_pattern(path) for path in sorted(PATTERNS.glob("*.json"))}
    assert len(found) >= 14
    assert len(found["tshirt"].panels) == 8 and len(found["tshirt"].stitches) == 16
