"""Sewing: seams close about the body, and the sewn cloth rests as its panels were cut."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from training.sewing.patterns import buttons, panel, sides, tube_skirt, written

from physkin_core import load_body_model
from physkin_core.model.garment import face_areas
from physkin_core.model.garment_model import Material
from physkin_core.quality import edge_strain
from physkin_prepare.wardrobe import PATTERNS
from physkin_training.contact.surface_queries import BodySurface, piercing_edges
from physkin_training.sewing.cut import cut
from physkin_training.sewing.paper_doll import Arms, paper_doll
from physkin_training.sewing.pattern import PatternError, load_pattern
from physkin_training.sewing.sew import _check_closed, _made, sewn
from physkin_training.sewing.squashed_faces import opened, squashed

BONES = "upperarm01", "wrist"
CPU = torch.device("cpu")
RIG = load_body_model().rig


def cut_of(folder, pattern):
    return cut(load_pattern(written(folder, pattern)), 0.04)


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    """The cut of a skirt of two panels."""
    return cut_of(tmp_path_factory.mktemp("skirt"), tube_skirt(waist=43.0))


def test_a_skirt_of_two_panels(mesh, template):
    """It hangs on the hips, and half of it lies before and half behind."""
    seen = []
    garment = sewn(mesh, template, RIG, Material(), CPU, watch=lambda vertices, *_: seen.append(vertices))
    n, edges, faces = len(garment.vertices), len(garment.edges), len(garment.faces)
    assert n == len(mesh.places) - len(mesh.seams) and n - edges + faces == 0, "a tube"
    assert garment.face_areas.sum() == pytest.approx(0.515, rel=1e-3), "what was cut"
    distance = BodySurface(template.vertices, template.faces).closest(garment.vertices).distance
    assert distance.min() > 0, "outside the body"
    assert edge_strain(garment, garment.vertices[None])[0] < 1.0
    floor = template.vertices[:, 2].min()
    assert 0.7 < garment.vertices[:, 2].max() - floor < 1.15 and np.ptp(garment.vertices[:, 2]) == pytest.approx(
        0.5, abs=0.05
    )
    assert not piercing_edges(garment.vertices, garment.faces, garment.edges).any()
    hung = [vertices for vertices in seen if len(vertices) == len(mesh.places)]
    assert np.abs(hung[-1] - hung[-6]).max() < 0.005, "it has come to rest"
    np.testing.assert_array_equal(seen[-1], garment.vertices)


def test_a_skirt_that_is_buttoned_in_front(tmp_path, template):
    """Both halves of the front are sewn to the back alone, and overlap by 2 cm: four buttons keep them together."""
    pattern = tube_skirt(waist=43.0)
    panels = pattern["pattern"]["panels"]
    panels["right"] = panel([[0, 0], [31, 0], [31, 50], [8.5, 50]], place=(-30, 50, 25))
    panels["front"] = panel([[29, 0], [60, 0], [51.5, 50], [29, 50]], place=(-30, 50, 26))
    pattern["pattern"]["stitches"] = sides(("front", 1, "back", 2), ("right", 3, "back", 0))
    pattern["pattern"]["closures"] = buttons(*(("front", 30, y, "right", 30, y) for y in (5, 20, 35, 48)))
    buttoned = cut_of(tmp_path, pattern)
    garment = sewn(buttoned, template, RIG, Material(), CPU)
    np.testing.assert_array_equal(garment.threads.shape, (4, 2))
    apart = np.linalg.norm(np.diff(garment.vertices[garment.threads], axis=1), axis=2)
    assert apart.max() < 0.004, "a gap of 2 mm, and 1 mm for each 3 N"
    assert garment.vertices[:, 2].min() < garment.vertices[garment.threads, 2].max() - 0.4, "on the hips"


def test_a_full_circle_hangs_below_the_arms(template):
    """Its panels are half circles, whose straight sides are sewn at the height of the elbows, 70 cm to either side."""
    garment = sewn(cut(load_pattern(PATTERNS / "circleskirt.json"), 0.04), template, RIG, Material(), CPU)
    assert BodySurface(template.vertices, template.faces).closest(garment.vertices).distance.min() > 0
    hands = template.bone_heads[[RIG.bone_names.index(f"wrist.{side}") for side in "LR"]]
    outside = np.abs(garment.vertices[:, 1]) > 0.9 * np.abs(hands[:, 1]).min()
    assert garment.vertices[outside, 2].max() < hands[:, 2].min()


def test_the_paper_doll(template):
    """Its arms go up with two sleeves whose far ends are 30 degrees above them."""
    doll, arms = paper_doll(template, RIG), Arms(template, RIG)
    sleeves = []
    for side, up in (("L", 30.0), ("R", -30.0)):
        shoulder, wrist = (template.bone_heads[RIG.bone_names.index(f"{bone}.{side}")] for bone in BONES)
        end = Rotation.from_euler("x", up, degrees=True).apply(wrist - shoulder)
        sleeves.append(shoulder + np.linspace(0.1, 0.9, 20)[:, None] * end)
    sleeves = np.concatenate(sleeves)
    arms.follow(SimpleNamespace(labels=("arm",), panel_of=np.zeros(40, int)), sleeves, sleeves)
    raised = arms.raised(doll)
    assert np.ptp(doll[:, 0]) < 0.5 * np.ptp(template.vertices[:, 0])
    hand = RIG.bone_names.index("wrist.L")
    in_hand = ((template.influence_bones == hand) & (template.influence_weights > 0.99)).any(axis=1)
    assert np.ptp(doll[in_hand], axis=0).max() < 0.02, "drawn in to the wrist"
    shoulder = template.bone_heads[RIG.bone_names.index("upperarm01.L")] * [0.1, 1, 1]
    for each, down in ((doll, 47.0), (raised, 17.0)):
        way = each[in_hand].mean(axis=0) - shoulder
        assert np.degrees(np.arctan2(-way[2], way[1])) == pytest.approx(down, abs=3)
    legs = template.vertices[:, 2] < -0.2
    np.testing.assert_array_equal(doll[legs], raised[legs])
    arms.follow(SimpleNamespace(labels=("leg",), panel_of=np.zeros(40, int)), sleeves, sleeves)
    np.testing.assert_allclose(np.degrees(arms.angles), 60.0, err_msg="without sleeves")


@pytest.mark.slow
def test_what_does_not_fit(tmp_path, template):
    """A waist of 30 cm does not go around the hips."""
    with pytest.raises(PatternError, match="fit the body"):
        sewn(cut_of(tmp_path, tube_skirt(width=15.0)), template, RIG, Material(), CPU)


def test_a_seam_that_does_not_close(mesh):
    """Front and back are left 12 cm apart."""
    apart = np.column_stack([0.12 * mesh.panel_of, mesh.places])
    words = "the seam of edge 3 of panel 'front' to edge 0 of 'back' does not close: .* does it fit the body"
    with pytest.raises(PatternError, match=words):
        _check_closed(mesh, apart)


def test_a_seam_between_wrong_edges(tmp_path, template):
    """Those of the front are exchanged: both seams would go through the body."""
    pattern = tube_skirt(waist=43.0)
    pattern["pattern"]["stitches"] = sides(("front", 1, "back", 0), ("front", 3, "back", 2))
    with pytest.raises(PatternError, match="edge [13] of panel 'front' to edge [02] of 'back' would close through"):
        sewn(cut_of(tmp_path, pattern), template, RIG, Material(), CPU)


def test_stitches_that_make_no_surface(mesh, template):
    """A third panel on an edge that two have already; said before anything is simulated."""
    twice = replace(mesh, seams=np.concatenate([mesh.seams, mesh.seams[:1, ::-1] + [[0, 1]]]))
    with pytest.raises(PatternError, match="an edge of panel '.*' would join 3 pieces of cloth, at most 2"):
        sewn(twice, template, RIG, Material(), CPU)


def test_squashed_faces_are_pulled_open():
    """Two vertices at a hem in one place: their faces come back, and cloth farther away stays."""
    x, y = np.meshgrid(0.02 * np.arange(40), 0.02 * np.arange(30))
    corner = (40 * np.arange(29)[:, None] + np.arange(39)).reshape(-1)
    faces = np.concatenate([corner[:, None] + [0, 1, 41], corner[:, None] + [0, 41, 40]])
    places = np.column_stack([x.ravel(), y.ravel()])
    flat = np.column_stack([places, np.zeros(len(places))])
    assert opened(flat, faces, places, faces) is flat
    pinched = flat.copy()
    pinched[20] = pinched[21] + [0, 0, 1e-5]
    assert squashed(pinched, faces, places, faces).sum() == 1
    found = opened(pinched, faces, places, faces)
    assert face_areas(found, faces) == pytest.approx(np.full(len(faces), 2e-4), rel=0.15)
    moved = np.linalg.norm(found - pinched, axis=1)
    assert 0.005 < moved.max() < 0.02 and not moved[np.abs(places - places[20]).max(axis=1) > 0.07].any()
    crushed = flat * [0.3, 1, 1]
    assert opened(crushed, faces, places, faces) is crushed, "no fold"


def test_what_is_squashed_all_over_is_told_with_its_panel(mesh):
    lying = np.column_stack([mesh.places * [0.2, 1], np.zeros(len(mesh.places))])
    with pytest.raises(PatternError, match=r"\(\d+ faces are squashed or drawn out, most of them of panel 'front'\)"):
        _made(mesh, np.where(mesh.panel_of[:, None] == mesh.names.index("front"), lying, lying * [5, 1, 1]), mesh.faces)


def test_a_panel_that_is_not_sewn(tmp_path, template):
    pattern = tube_skirt()
    pattern["pattern"]["panels"]["patch"] = panel([[0, 0], [9, 0], [9, 9], [0, 9]], place=(0, 60, 30))
    with pytest.raises(PatternError, match="panel 'patch' is not sewn to anything; every panel needs a stitch"):
        sewn(cut_of(tmp_path, pattern), template, RIG, Material(), CPU)
