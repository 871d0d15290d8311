"""How a garment is worn: parts each vertex lies on and the band of the uppermost opening."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from random_models import cape, opened_in_front, tube
from scipy.spatial import cKDTree

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment, load_garment
from physkin_core.model.garment_model import Material
from physkin_core.model.surface_paths import path_lengths
from physkin_training.contact.touching_places import FAR, TouchingPlaces
from physkin_training.contact.wearing import BAND_WIDTH, WORN_WITHIN, Wearing
from physkin_training.energies.band import BAND_SLACK
from physkin_training.evaluate.plain_model import plain_model
from physkin_training.evaluate.simulate import DrapeSimulation

GARMENTS = Path(__file__).parents[3] / "training" / "garments"
BODY = load_body_model()
SURFACE = BODY.vertices(BODY.garment_body)
BONES = BODY.rig.bone_names


@cache
def wearing(name: str) -> tuple[Garment, Wearing]:
    garment = load_garment(GARMENTS / f"{name}.obj")
    return garment, Wearing.of(garment, BODY)


def far_from_all(garment: Garment) -> np.ndarray:
    """(n,) bool, the cloth that hangs free of the whole body."""
    return cKDTree(SURFACE).query(garment.vertices)[0] > WORN_WITHIN


@pytest.mark.parametrize(
    "name, lowest, highest",
    [("tshirt", 0.45, 0.6), ("dress", 0.4, 0.6), ("trousers", 0.1, 0.2), ("skirt", 0.05, 0.12)],
)
def test_the_band_is_the_neckline_or_the_waistline(name, lowest, highest):
    """Heights above the root [m]; both sides of the opening; each vertex placed on the closest body vertex."""
    garment, worn = wearing(name)
    band = garment.vertices[worn.band]
    assert lowest < band[:, 2].min() and band[:, 2].max() < highest
    assert band[:, 1].min() < -0.05 and band[:, 1].max() > 0.05
    distance = np.linalg.norm(SURFACE[worn.band_place] - band, axis=1)
    np.testing.assert_allclose(worn.band_distance, distance, atol=1e-6)
    nearest = np.linalg.norm(SURFACE[None] - band[::20, None], axis=2).min(axis=1)
    np.testing.assert_allclose(distance[::20], nearest, atol=1e-6)


def limb_of(garment: Garment) -> np.ndarray:
    """(n,) -1 on an arm or leg of the right, 1 on one of the left, 0 on the trunk: where the closest skin is."""
    strongest = BODY.influence_bones[np.arange(len(SURFACE)), BODY.influence_weights.argmax(axis=1)]
    side = np.array([(".L" in name) - (".R" in name) for name in BONES])
    limbs = np.array([any(part in name for part in ("arm", "leg", "hand", "foot")) for name in BONES])
    return (side * limbs)[strongest[cKDTree(SURFACE).query(garment.vertices)[1]]]


@pytest.mark.parametrize(
    "name, meets", [("tshirt", [(-1, 0), (0, -1), (1, 0), (0, 1)]), ("trousers", [(-1, 1), (1, -1)])]
)
def test_sleeves_may_touch_the_sides_and_one_leg_the_other(name, meets):
    """Both ways, where their outsides meet; no vertex may touch what is beside it."""
    garment, worn = wearing(name)
    touching, limb = worn.touching, limb_of(garment)
    vertex, rank = np.nonzero(touching.candidate >= 0)
    place = touching.place[touching.candidate[vertex, rank]]
    outsides = touching.side[vertex, rank] == 2
    for one, other in meets:
        assert len(np.unique(vertex[(limb[vertex] == one) & (limb[place] == other) & outsides])) > 100
    for some in range(0, len(garment.vertices), 500):
        assert (path_lengths(garment.vertices, garment.faces, [some])[place[vertex == some]] > 0.95 * FAR).all()
    again = Wearing.of(garment, BODY).touching
    for one, other in zip(vars(touching).values(), vars(again).values()):
        np.testing.assert_array_equal(one, other)


def test_collars_lapels_and_pleats_are_turned_inside_out(monkeypatch):
    """Small parts of these garments, and nothing of the others."""
    monkeypatch.setattr(TouchingPlaces, "find", lambda *_: None)
    share = {path.stem: Wearing.of(load_garment(path), BODY).inside_out.mean() for path in GARMENTS.glob("*.obj")}
    turned = {name for name in share if share[name] > 0}
    assert turned == {"dressshirt", "polo", "blazer", "coat", "pleatedskirt"}
    assert max(share.values()) < 0.05


def test_the_fall_of_a_collar_is_turned_inside_out():
    """A band about the waist whose upper half is turned down over the lower one: its outside faces the body."""
    band = tube(rings=11, segments=60, radius=1.0, height=0.2)
    ring = np.arange(len(band.vertices)) // 60
    height, wider = 0.1 + 0.01 * np.minimum(ring, 10 - ring), np.where(ring > 5, 0.012, 0.0)
    away = np.array([0.13, 0.17]) + wider[:, None]
    garment = Garment(np.column_stack([band.vertices[:, :2] * away, height]), band.faces)
    worn = Wearing.of(garment, BODY)
    near = cKDTree(SURFACE).query(garment.vertices)[0] < 0.03
    assert worn.inside_out[near & (ring > 6)].all() and not worn.inside_out[ring < 5].any()
    assert (near & (ring > 6)).sum() > 60


def test_the_higher_of_two_openings_counts():
    """A tube: its upper ring and all within the band's width of it."""
    garment = tube(rings=11, segments=30, radius=0.2, height=0.2)
    worn = Wearing.of(garment, BODY)
    height = garment.vertices[:, 2]
    expected = np.flatnonzero(height.max() - height < BAND_WIDTH)
    np.testing.assert_array_equal(worn.band, expected)
    assert len(expected) == 60


def test_a_cape_is_held_by_its_collar():
    """Of a rim that is collar, front edges and hem in one, the upper 10 cm; front edges and hem hang free."""
    garment = cape()
    worn = Wearing.of(garment, BODY)
    band, top = garment.vertices[worn.band], garment.vertices[:, 2].max()
    assert band[:, 2].max() == top and top - 0.13 < band[:, 2].min() < top - 0.05
    assert band[:, 1].min() < -0.1 and band[:, 1].max() > 0.1 and band[:, 0].min() < -0.1
    assert not worn.bare.any() and (worn.far_face < 0).all()


@pytest.fixture(scope="module")
def cardigan() -> tuple[Garment, Wearing]:
    garment = opened_in_front(load_garment(GARMENTS / "longsleeve.obj"))
    return garment, Wearing.of(garment, BODY)


def test_an_open_front_hangs_from_the_shoulders(cardigan):
    """From the back of the neck, and on both sides almost out to the joints; the front edges are free."""
    garment, worn = cardigan
    band = garment.vertices[worn.band]
    joints = BODY.bones(BODY.garment_body)[0][[BONES.index(f"upperarm01.{side}") for side in "LR"]]
    assert band[:, 0].min() < -0.07 and band[:, 0].max() < joints[:, 0].mean() + 0.05, "none of it before the neck"
    assert band[:, 1].max() > 0.6 * joints[0, 1] and band[:, 1].max() < 0.8 * joints[0, 1]
    assert band[:, 1].min() < 0.6 * joints[1, 1] and band[:, 2].min() > joints[:, 2].mean()
    edge = (np.abs(garment.vertices[:, 1]) < 2e-3) & (garment.vertices[:, 0] > 0.04)
    assert edge.sum() > 80 and not edge[worn.band].any()


@pytest.mark.slow
def test_an_open_front_stays_on_the_shoulders_while_arms_are_raised(cardigan):
    """Sleeves draw cloth off the neck, as far as the band's slack; without a band farther, and on with every step."""
    garment, worn = cardigan
    avatar, names = avatar_from_body(BODY, BODY.garment_body), [dof.name for dof in BODY.rig.dofs]
    raised, moved = BODY.rig.rest.copy(), []
    for joint, angle in (("upperarm01", 1.9), ("clavicle", 0.3)):
        raised[[names.index(f"{joint}.{side}_x") for side in "LR"]] += angle
    nothing = replace(worn, band=worn.band[:0], band_place=worn.band_place[:0], band_distance=worn.band_distance[:0])
    for each in (worn, nothing):
        given = garment, avatar, plain_model(garment), Material(), 1, torch.device("cpu")
        simulation = DrapeSimulation(*given, wearing=each)
        result = simulation.run(raised[None], np.array([[0.0, 0.0, -1.0]]), stages=3, iterations=40)
        body = simulation.body.vertices[0].numpy()
        away = np.linalg.norm(result.vertices[0].numpy()[worn.band] - body[worn.band_place], axis=1)
        moved.append(float((away - worn.band_distance).mean()))
    assert moved[0] < BAND_SLACK < moved[1], moved


def test_a_cape_hangs_around_trunk_and_legs():
    """Most of it is far from the body, and yet heels, thighs and the small of a stout back push it."""
    garment = cape()
    worn = Wearing.of(garment, BODY)
    free = far_from_all(garment)
    assert free.mean() > 0.5 and worn.worn[free].any(axis=1).all() and not worn.other_limb[free].any()
    legs = [f"{bone}.{side}" for bone in ("upperleg02", "lowerleg01", "lowerleg02", "foot") for side in "LR"]
    hem = np.linalg.norm(garment.vertices - [-0.54, 0.0, -0.49], axis=1).argmin()
    assert free[hem] and worn.worn[hem, [BONES.index(part) for part in legs]].all()
    back = np.linalg.norm(garment.vertices - [-0.42, 0.0, 0.05], axis=1).argmin()
    small_of_the_back = [BONES.index(part) for part in ("spine04", "spine05")]
    assert free[back] and worn.worn[back, small_of_the_back].all()
    touched = set(np.array(BONES)[worn.worn_faces().face_bone])
    assert touched >= {*legs, "spine03", "spine04", "spine05", "pelvis.L", "pelvis.R"}


def test_a_poncho_is_no_trouser_leg():
    """Its hem goes around the hips, so close to the head of a thigh that it might be a leg's."""
    cone = tube(rings=30, segments=80, radius=1.0, height=1.0)
    share = 0.5 - cone.vertices[:, 2:]
    across = cone.vertices[:, :2] * (np.array([0.10, 0.12]) + np.array([0.30, 0.60]) * share**0.5) - [0.02, 0.0]
    garment = Garment(np.column_stack([across, 0.56 - 0.62 * share]), cone.faces)
    worn = Wearing.of(garment, BODY)
    legs = [BONES.index(f"upperleg01.{side}") for side in "LR"]
    assert worn.worn[:, legs].any(axis=0).all() and (worn.far_face == -1).all()


@pytest.mark.parametrize("name", ["skirt", "circleskirt", "dress", "maxidress", "pencilskirt", "widetrousers"])
def test_a_hem_hangs_around_parts_that_other_cloth_lies_on(name):
    """It adds none to the contact: no arm beside a skirt. Of two trouser legs each hangs around the limb in it."""
    garment, worn = wearing(name)
    free = far_from_all(garment)
    assert worn.worn[free].any(), name
    assert not (worn.worn[free].any(axis=0) & ~worn.worn[~free].any(axis=0)).any(), name
    if name == "widetrousers":
        for side, other in ("LR", "RL"):
            hem = free & (garment.vertices[:, 1] > 0 if side == "L" else garment.vertices[:, 1] < 0)
            assert hem.any() and not worn.worn[np.ix_(hem, [BONES.index(f"lowerleg01.{other}")])].any()


def test_a_closed_surface_is_refused():
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    corners = [[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
    with pytest.raises(ValueError, match="no opening"):
        Wearing.of(Garment(np.array(corners), np.array(faces)), BODY)


def test_parts_a_shirt_is_worn_on():
    """The trunk under its front and an arm under its sleeve; no hand and no foot anywhere."""
    garment, worn = wearing("tshirt")
    sleeve = garment.vertices[:, 1].argmax()
    belly = np.linalg.norm(garment.vertices - [0.15, 0.0, 0.15], axis=1).argmin()
    assert worn.worn[sleeve, BONES.index("upperarm02.L")] and not worn.worn[sleeve, BONES.index("spine03")]
    assert worn.worn[belly, BONES.index("spine04")] and not worn.worn[belly, BONES.index("upperarm02.L")]
    side = np.linalg.norm(garment.vertices - [0.05, 0.15, 0.27], axis=1).argmin()
    arm = [worn.worn[side, BONES.index(part)] for part in ("upperarm01.L", "upperarm02.L")]
    assert worn.worn[side, BONES.index("spine02")] and not any(arm), garment.vertices[side]
    for part in ("wrist.L", "wrist.R", "foot.L", "lowerleg02.R"):
        assert not worn.worn[:, BONES.index(part)].any(), part


def test_limbs_that_pass_by_the_cloth():
    """The arm beside the trunk of a T-shirt, but not to its sleeve; neither leg to the side of a skirt."""
    garment, worn = wearing("tshirt")
    side = np.linalg.norm(garment.vertices - [0.05, 0.2, 0.2], axis=1).argmin()
    arm = [BONES.index(part) for part in ("clavicle.L", "upperarm01.L", "upperarm02.L", "lowerarm01.L")]
    assert worn.other_limb[side, arm].all() and not worn.other_limb[side, BONES.index("spine04")]
    sleeve = np.linalg.norm(garment.vertices - [0.0, 0.26, 0.45], axis=1).argmin()
    assert worn.worn[sleeve, arm].any() and not worn.other_limb[sleeve, arm].any()
    assert not (worn.worn & worn.other_limb).any()
    garment, worn = wearing("skirt")
    side = np.linalg.norm(garment.vertices - [0.0, 0.25, -0.15], axis=1).argmin()
    legs = [BONES.index(part) for part in ("upperleg01.L", "upperleg02.L", "upperleg01.R", "upperleg02.R")]
    assert not worn.worn[side, legs[2:]].any() and not worn.other_limb[side, legs].any()
    hem = far_from_all(garment)
    assert hem.any() and not worn.other_limb[hem].any()


def test_an_arm_without_a_sleeve_is_bare():
    """From the bone on that leaves through the armhole: only the rim on the shoulder is worn on it, the armpit is the
    trunk's, and the whole arm stays in contact. No arm with a sleeve, no neck and no leg is bare."""
    garment, worn = wearing("tanktop")
    bones = ("upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist")
    assert sorted(np.array(BONES)[worn.bare]) == sorted(f"{bone}.{side}" for bone in bones for side in "LR")
    assert np.isin(np.flatnonzero(worn.bare), worn.worn_faces().face_bone).all()
    arm = BONES.index("upperarm01.L")
    shoulder = np.linalg.norm(garment.vertices - [0.07, 0.17, 0.47], axis=1).argmin()
    armpit = np.linalg.norm(garment.vertices - [-0.03, 0.18, 0.33], axis=1).argmin()
    assert worn.worn[shoulder, arm] and not worn.other_limb[shoulder, arm]
    assert worn.worn[armpit, BONES.index("spine02")] and worn.other_limb[armpit, arm] and not worn.worn[armpit, arm]
    for name in ("tshirt", "longsleeve", "dress", "trousers", "skirt"):
        assert not wearing(name)[1].bare.any(), name


def test_worn_faces_are_those_near_the_garment():
    """All faces of a part or none; what is left out is farther from the cloth than the limit."""
    garment, worn = wearing("skirt")
    left = worn.worn_faces()
    assert 0 < len(left.faces) < len(worn.faces) == len(BODY.faces)
    assert set(left.face_bone) == set(np.flatnonzero(worn.worn.any(axis=0)))
    np.testing.assert_array_equal(left.worn, worn.worn)
    own = SURFACE[left.faces[left.own_face]].mean(axis=1)
    nearest = np.linalg.norm(SURFACE[left.faces].mean(axis=1)[None] - garment.vertices[::40, None], axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(own - garment.vertices, axis=1)[::40], nearest, atol=1e-6)
    outside = worn.faces[~np.isin(worn.face_bone, left.face_bone)]
    whole = SURFACE[outside[::50]].mean(axis=1)
    distance = np.linalg.norm(whole[:, None] - garment.vertices[None], axis=2).min(axis=1)
    assert distance.min() > WORN_WITHIN - 0.03


def test_across_a_sleeve_is_the_limbs_far_side():
    """On the other side of the arm's bone, of the same part; none for the trunk, bare arms and what has no far side."""
    garment, worn = wearing("tshirt")
    avatar = avatar_from_body(BODY, BODY.garment_body)
    centres = SURFACE[worn.faces].mean(axis=1)
    arm = BONES.index("upperarm02.L")
    sleeve = worn.face_bone[worn.own_face] == arm
    assert (worn.far_face[sleeve] >= 0).all() and (worn.face_bone[worn.far_face[sleeve]] == arm).all()
    axis = avatar.bone_tails[arm] - avatar.bone_heads[arm]
    near, far = (
        _off_the_axis(centres[face[sleeve]] - avatar.bone_heads[arm], axis) for face in (worn.own_face, worn.far_face)
    )
    assert (np.einsum("vi,vi->v", near, far) < 0).all()
    trunk = np.char.startswith(np.array(BONES)[worn.face_bone[worn.own_face]], "spine")
    assert trunk.any() and (worn.far_face[trunk] == -1).all()
    np.testing.assert_array_equal(worn.worn_faces().far_face < 0, worn.far_face < 0)
    assert (wearing("tanktop")[1].far_face == -1).all()


def _off_the_axis(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    return vectors - np.outer(vectors @ axis / (axis @ axis), axis)
