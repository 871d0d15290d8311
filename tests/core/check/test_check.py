"""Rest check, verdicts and `physkin check`, on the bundled avatar and on others whose flesh was moved or cut away."""

import json
from dataclasses import replace

import numpy as np
import pytest
from gltf_person import dressed_document
from PIL import Image

from physkin_core import (
    BUNDLED_AVATAR,
    AvatarWarning,
    Draper,
    Outfit,
    avatar_from_body,
    cli,
    load_avatar,
    load_body_model,
    load_garment_model,
)
from physkin_core.check import check
from physkin_core.check.advice import OutfitCheck, reason_and_advice
from physkin_core.check.garment_check import Everyday, GarmentCheck, RestCheck, rest_check, stands_off_mm
from physkin_core.check.likeness import Likeness, body_overlap, likeness
from physkin_core.check.sight import hole_percent
from physkin_core.formats.gltf_builder import write_glb
from physkin_core.motion.everyday_poses import everyday_poses

WELL, BADLY = RestCheck(0.0, 0.0, 0.0), RestCheck(3.0, 5.0, 1.0)
USUAL = Likeness(0.5, 1.0, 1.0, "neck01", 5.0, "neck01")
GOOD, BAD = GarmentCheck(WELL, Everyday(0.0, 0.0, 1.0)), GarmentCheck(BADLY, Everyday(3.0, 5.0, 9.0))


@pytest.fixture(scope="module")
def tshirt():
    return load_garment_model("tshirt")


@pytest.fixture(scope="module")
def avatar(tshirt):
    return load_avatar(BUNDLED_AVATAR, tshirt.rig)


@pytest.fixture
def few_poses(monkeypatch):
    """Four everyday poses in place of twenty."""
    monkeypatch.setattr(check, "everyday_poses", lambda rig: tuple(each[::5] for each in everyday_poses(rig)))


def on_back(points, reach=0.12):
    """How much of a bump 1 high at the upper back each point (n, 3) has."""
    return np.exp(-np.square((points - [-0.12, 0.0, 0.38]) / reach).sum(axis=1))


def test_a_bump_of_skin_through_cloth_is_found_where_it_is(tshirt, avatar):
    """The back is pushed 6 cm through the cloth of the body as it was: as many vertices are inside as lie under the
    bump, as deep as it is, and about as much skin shows."""
    cloth = Draper(tshirt, avatar).drape(tshirt.rig.rest)[:, :3]
    assert rest_check(tshirt.garment, cloth, avatar.vertices, avatar.faces).sits_well
    bump = 0.06 * on_back(avatar.vertices)[:, None] * [-1.0, 0.0, 0.0] * (avatar.vertices[:, :1] < 0)
    found = rest_check(tshirt.garment, cloth, avatar.vertices + bump, avatar.faces)
    assert found.sits_badly and not found.sits_well
    assert 20 < found.deepest_mm < 60
    assert 2 < found.inside_percent < 20 and 2 < found.skin_shows_percent < 20
    assert f"{found.inside_percent:.2f} % of the cloth" in str(found)


def test_skin_near_a_hem_and_bare_skin_do_not_show(tshirt, avatar):
    """Legs, arms and head are bare; at the hem cloth may be under the skin."""
    cloth = Draper(tshirt, avatar).drape(tshirt.rig.rest)[:, :3].copy()
    hem = cloth[:, 2] < cloth[:, 2].min() + 0.02
    cloth[hem] *= [0.3, 0.3, 1.0]
    found = rest_check(tshirt.garment, cloth, avatar.vertices, avatar.faces)
    assert found.inside_percent > 0.5 and found.skin_shows_percent < 0.005


def test_binding_says_how_it_sits(tshirt, avatar):
    """One sentence as a warning and among the avatar's; none where it sits well."""
    folds = (0.06 * np.sin(60 * avatar.vertices[:, [1, 2, 0]])).astype(np.float32)
    crumpled = replace(avatar, vertices=avatar.vertices + folds, warnings=("assumed something",), source="paper.glb")
    with pytest.warns(AvatarWarning, match=r"tshirt on paper.glb: [0-9.]+ % of the cloth is inside the body at rest"):
        draper = Draper(tshirt, crumpled)
    assumed, sits = draper.avatar.warnings
    assert assumed == "assumed something" and sits.endswith("run physkin check")
    assert Draper(tshirt, avatar).avatar.warnings == avatar.warnings


@pytest.mark.parametrize(
    "rest, everyday_inside, stands_off, verdict",
    [
        (WELL, 0.9, 14, "good"),
        (WELL, 1.1, 0, "usable"),
        (WELL, 0.0, 15, "usable"),
        (WELL, 0.0, 41, "bad"),
        (RestCheck(0.05, 1.0, 0.0), 0.0, 0, "good"),
        (RestCheck(0.06, 1.0, 0.0), 0.0, 0, "usable"),
        (RestCheck(0.0, 0.0, 0.1), 0.0, 0, "usable"),
        (RestCheck(2.0, 20.0, 5.0), 9.0, 0, "usable"),
        (RestCheck(2.1, 1.0, 0.0), 0.0, 0, "bad"),
        (RestCheck(0.1, 20.1, 0.0), 0.0, 0, "bad"),
    ],
)
def test_verdicts(rest, everyday_inside, stands_off, verdict):
    assert GarmentCheck(rest, Everyday(everyday_inside, 3.0, 2.0), stands_off).verdict == verdict


@pytest.mark.parametrize("percent, verdict", [(0.09, "good"), (0.11, "usable"), (1.1, "bad")])
def test_holes_are_in_the_verdict(percent, verdict):
    assert OutfitCheck({"tshirt": GOOD}, USUAL, hole_percent=percent).verdict == verdict
    assert OutfitCheck({"tshirt": BAD}, USUAL, hole_percent=percent).verdict == "bad"


def test_a_waistband_that_stands_off_is_found(avatar):
    """Trousers where the waist behind the cloth is 4 cm thinner stand off by about that; on the body as it is, not."""
    model = load_garment_model("trousers")
    layer = Draper(model, avatar).layer
    (cloth,) = layer.drape([(model.rig.rest, [0.0, 0.0, -1.0])])
    cloth = cloth[:, :3]
    assert stands_off_mm(layer, cloth, avatar.vertices, avatar.faces) < 5
    top = cloth[:, 2].max()
    waist = np.exp(-(((avatar.vertices[:, 2:] - top) / 0.12) ** 2)) * (np.abs(avatar.vertices[:, 1:2]) < 0.25)
    out = avatar.vertices * [1, 1, 0] / np.linalg.norm(avatar.vertices[:, :2], axis=1, keepdims=True)
    thin = avatar.vertices - 0.04 * waist * out
    assert 25 < stands_off_mm(layer, cloth, thin, avatar.faces) < 60


def test_a_hole_in_the_chest_is_in_sight_unless_a_shirt_covers_it(avatar, tshirt):
    centres = avatar.vertices[avatar.faces].mean(axis=1)
    holed = replace(avatar, faces=avatar.faces[np.linalg.norm(centres - [0.15, 0, 0.25], axis=1) > 0.1])
    trousers = load_garment_model("trousers")
    assert hole_percent(Outfit([tshirt], holed)) < 0.05  # half of what counts
    assert hole_percent(Outfit([trousers], holed)) > 1  # 20 cm wide, on a figure of some square metre: a bad one
    # lines of sight that pass between faces, as processors differ in, are single pixels and do not count
    assert hole_percent(Outfit([trousers], avatar)) == 0


def test_likeness_names_the_pivot_that_is_elsewhere(avatar, tshirt):
    rig = tshirt.rig
    usual = likeness(avatar, rig)
    assert usual.shape_deviation < 2 and usual.skin_distance_mm < 3 and usual.pivot_distance_mm < 15
    heads = avatar.bone_heads.copy()
    bone = rig.bone_names.index("upperarm01.L")
    heads[bone] += [0.0, 0.0, 0.08]
    odd = likeness(replace(avatar, bone_heads=heads), rig)
    assert odd.pivot_bone == "upperarm01.L" and 60 < odd.pivot_distance_mm < 90
    reason, advice = reason_and_advice(OutfitCheck({"tshirt": BAD}, odd))
    assert "upperarm01.L lies" in reason and advice == ""


@pytest.mark.parametrize("group", ["children", "elders"])
def test_children_and_elders_are_usual_bodies_of_their_stature(group, tshirt):
    """Each is nearer to the average than the rarest of its kind, and none of its flesh is missing."""
    body = load_body_model()
    for coefficients in getattr(body, f"held_out_{group}")[:3]:
        found = likeness(avatar_from_body(body, coefficients), tshirt.rig)
        assert found.shape_deviation < 2.5 and found.skin_distance_mm < 1 and found.pivot_distance_mm < 1


def test_overlap_is_that_of_parts_in_each_other(avatar, tshirt):
    """Thighs pulled up are in the belly; arms and legs apart are in nothing but their own creases."""
    rig = tshirt.rig
    thighs = [name.startswith("upperleg01") and name.endswith("_y") for name in rig.joint_names]
    apart, folded = (body_overlap(avatar, rig, np.where(up, rig.lower, rig.rest)[None]) for up in (False, thighs))
    assert apart < 0.8 and folded > apart + 1


@pytest.mark.parametrize(
    "found, reason, advice",
    [
        ({}, "Some cloth is under the skin at rest", ""),
        ({"overlap_percent": 20.0}, "20 % of the skin is inside the body", "--separate-limbs"),
        ({"overlap_percent": 20.0, "limbs_apart": True}, "Some cloth is under the skin at rest", ""),
        ({"known": Likeness(0.5, 1.0, 1.5, "neck01", 5.0, "neck01")}, "neck01 is 1.50 times as long", ""),
        ({"known": Likeness(3.0, 1.0, 1.0, "neck01", 5.0, "neck01")}, "3.0 standard deviations", ""),
        ({"bare": ("the left thigh",)}, "no skin on the left thigh", "Wear what does not cover that."),
        ({"height": 0.7}, "0.70 m tall, and garments were made for 0.9 to 2.1 m", ""),
        ({"height": 2.5}, "2.50 m tall, and garments were made for 0.9 to 2.1 m", ""),
        ({"height": 1.1}, "Some cloth is under the skin at rest", ""),
        ({"height": 1.1, "measured": False}, "The body is a child's, 1.10 m tall", "--fit 1"),
        ({"hole_percent": 0.7}, "0.7 % of what one sees is the inside", "Close the skin in a modelling tool"),
        ({"hole_percent": 0.7, "undressed": True}, "0.7 % of what one sees", "--own-clothes keep"),
        ({"garments": {"skirt": GarmentCheck(WELL, Everyday(0, 0, 1), 31.0)}}, "of skirt stands off by 31 mm", ""),
        (
            {"garments": {"skirt": GarmentCheck(WELL, Everyday(0, 0, 1), 31.0)}, "measured": False},
            "of skirt stands off by 31 mm",
            "--fit 1",
        ),
    ],
)
def test_reasons_are_what_stands_out_and_advice_can_be_followed(found, reason, advice):
    said = reason_and_advice(OutfitCheck(**{"garments": {"good": GOOD, "bad": BAD}, "known": USUAL, **found}))
    assert reason in said[0] and advice in said[1] and bool(advice) == bool(said[1])


def test_nothing_is_the_matter_with_what_is_good():
    assert reason_and_advice(OutfitCheck({"good": GOOD}, USUAL)) == ("", "Wear it.")


def test_everyday_poses_are_within_the_limits():
    rig = load_body_model().rig
    positions, gravity = everyday_poses(rig)
    assert positions.shape == (20, len(rig.joint_names)) and gravity.shape == (20, 3)
    assert (positions >= rig.lower - 1e-3).all() and (positions <= rig.upper + 1e-3).all()
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), 1, atol=1e-3)
    with pytest.raises(ValueError, match="of the default rig"):
        everyday_poses(replace(rig, dofs=rig.dofs[:-1]))


def test_the_command_writes_what_it_says(tmp_path, capsys, few_poses):
    """Two garments: the worst of both, and each by name; status 0 for what can be worn, 2 for what cannot be read."""
    path = tmp_path / "check.json"
    assert cli.main(["check", str(BUNDLED_AVATAR), "-g", "shorts", "-g", "tshirt", "--json", str(path)]) == 0
    report = json.loads(path.read_text())
    assert set(report["garments"]) == {"tshirt", "shorts"}
    for key in ("inside_percent", "deepest_mm", "edge_strain_percent"):
        assert report["everyday"][key] == max(garment["everyday"][key] for garment in report["garments"].values())
    assert report["rest"]["inside_percent"] == report["skin_shows_percent"] == 0
    assert report["verdict"] in ("good", "usable") and 0.5 < report["everyday"]["edge_strain_percent"] < 6
    out = capsys.readouterr().out
    said = " ".join(filter(None, (f"{report['verdict']}:", report["reason"], report["advice"])))
    assert "tshirt: " in out and out.splitlines()[-1] == said
    assert cli.main(["check", str(tmp_path / "nobody.glb")]) == 2
    assert "nobody.glb" in capsys.readouterr().err


def test_the_command_separates_limbs_when_told_to(tmp_path, few_poses):
    """Less of the skin is inside the body in everyday poses then; at rest nothing changes."""
    reports = []
    for options in ([], ["--separate-limbs"]):
        path = tmp_path / "check.json"
        assert cli.main(["check", str(BUNDLED_AVATAR), "-g", "tshirt", "--json", str(path), *options]) == 0
        reports.append(json.loads(path.read_text()))
    plain, separated = reports
    assert separated["body_overlap_percent"] < plain["body_overlap_percent"]
    assert separated["rest"] == plain["rest"]
    assert separated["everyday"] != plain["everyday"]


def test_the_picture_shows_the_avatar_in_its_own_colours(tmp_path, monkeypatch):
    """Four poses from two sides; trousers as blue as in its file, hair as brown, and the new T-shirt over them."""
    monkeypatch.setattr(check, "PICTURE_SIZE", (78, 132))
    monkeypatch.setattr(check, "check_garment", lambda *_, **__: GOOD)
    write_glb(tmp_path / "me.glb", dressed_document(sleeves="short", skin_beneath=True))
    picture = tmp_path / "check.png"
    cli.main(["check", str(tmp_path / "me.glb"), "-g", "tshirt", "-o", str(picture)])
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    assert pixels.shape[0] > 2 * 120 and pixels.shape[1] > 4 * 75
    red, green, blue = np.moveaxis(pixels, 2, 0)
    trousers = (blue > red + 50) & (red > green - 12)
    shirt = (blue > red + 50) & (green > red + 25)
    for column in range(4):
        part = slice(column * pixels.shape[1] // 4, (column + 1) * pixels.shape[1] // 4)
        assert trousers[:, part].sum() > 180 and shirt[:, part].sum() > 180
