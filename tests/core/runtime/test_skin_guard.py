"""Cloth that hangs free stays out of legs and trunk, and gives way to hands; nothing else is touched."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from random_models import random_sway_network
from reference.frame import ReferenceFrame
from reference.guard.skin_guard import skin_depth

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model
from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.body_shape.skin_parts import fit_skin_parts
from physkin_core.quality import edge_strain, signed_distance
from physkin_core.runtime.bound_garment import BoundGarment

RATE = 30.0
INSIDE = 0.002
"""[m] A vertex deeper in the skin than this counts."""
SWINGS = 0.2
"""By how much of what a random sway network gives cloth swings here."""


model_of = cache(load_garment_model)


def swinging(name, swings=SWINGS):
    """A shipped garment that sways by a network which knows nothing of legs, by such a share of what it gives."""
    model = model_of(name)
    modulation = 2 * sum(len(bias) for _, bias in model.pose_modulator[:-1])
    sizes = len(model.rig.dofs), len(model.node_rest)
    sway = random_sway_network(np.random.default_rng(1), *sizes, modulation=modulation, offset=0.02)
    return replace(model, sway=replace(sway, out=tuple(np.float32(swings) * each for each in sway.out)))


def hanging_still(name):
    """A shipped garment whose cloth hangs from the root, whatever the legs do."""
    model = model_of(name)
    weight, bias = model.node_deformer[-1]
    at_root = np.full_like(model.node_bone, model.rig.bone_names.index("root"))
    deformer = (*model.node_deformer[:-1], (0 * weight, 0 * bias))
    return replace(model, detail=None, sway=None, node_bone=at_root, node_deformer=deformer)


@cache
def bundled_avatar():
    return load_avatar(BUNDLED_AVATAR, model_of("skirt").rig)


def on_the_avatar(model):
    return Draper(model, bundled_avatar())


@pytest.fixture(scope="module")
def skirt():
    return on_the_avatar(swinging("skirt"))


def march(rig, frames: int) -> np.ndarray:
    """(frames, d) [rad] thighs that swing to and fro twice a second, at rest in the first frame."""
    joints = [rig.joint_names.index(f"upperleg01.{side}_y") for side in "LR"]
    swing = 0.7 * np.sin(2 * np.pi * 2.0 * np.arange(frames) / RATE)
    positions = np.tile(rig.rest, (frames, 1)).astype(np.float32)
    positions[:, joints] += np.stack([swing, -swing], axis=1).astype(np.float32)
    return positions


def walked(draper: Draper, bound: BoundGarment, motion: np.ndarray) -> np.ndarray:
    """(frames, n, 3) the cloth in a motion, swaying in full."""
    outfit = draper.outfit.with_bound_garment(0, bound)
    root = np.array([0, 0, 0, 0, 0, 0, 1.0])
    return np.array(
        [outfit.drape(pose, time=k / RATE, root=root)[0][:, :3] for k, pose in enumerate(motion)], dtype=np.float64
    )


def inside(draper: Draper, motion: np.ndarray, cloth: np.ndarray, legs: np.ndarray) -> np.ndarray:
    """Of each frame, how many vertices are in a leg. legs: (V,) bool, skin of legs."""
    avatar, counts = draper.avatar, []
    faces = avatar.faces[legs[avatar.faces].all(axis=1)]
    for pose, points in zip(motion, cloth):
        body = avatar.posed_vertices(draper.bone_transforms(pose))
        distance = signed_distance(points, body, avatar.faces)
        nearest = signed_distance(points, body, faces)
        counts.append(int(((distance < -INSIDE) & (np.abs(nearest) < np.abs(distance) + 1e-6)).sum()))
    return np.array(counts)


def test_legs_that_march_stay_under_the_skirt(skirt):
    """With sway that has not seen the motion: none inside where without the guard there are many; cloth strains hardly
    more, as most of what it lacks is sway that it gives up."""
    rig, motion = skirt.layer.model.rig, march(skirt.layer.model.rig, 16)
    thighs = [k for k, name in enumerate(rig.bone_names) if "leg" in name]
    legs = np.isin(skirt.avatar.influence_bones[:, 0], thighs)
    guarded, free = (
        walked(skirt, bound, motion) for bound in (skirt.layer.bound_visible, skirt.layer.bound_visible.unguarded)
    )
    seen, without = inside(skirt, motion, guarded, legs), inside(skirt, motion, free, legs)
    assert without.max() > 15
    assert seen.max() <= 3
    rest = skirt.layer.rest_garment
    assert edge_strain(rest, guarded).mean() < edge_strain(rest, free).mean() + 0.04


def test_legs_stay_in_trousers_that_sway():
    """Shipped ones, each leg round its own: a twentieth of what comes through without the guard."""
    trousers = on_the_avatar(model_of("widetrousers"))
    rig = trousers.layer.model.rig
    motion = march(rig, 16)
    legs = np.isin(trousers.avatar.influence_bones[:, 0], [k for k, name in enumerate(rig.bone_names) if "leg" in name])
    seen, without = (
        inside(trousers, motion, walked(trousers, bound, motion), legs)
        for bound in (trousers.layer.bound_visible, trousers.layer.bound_visible.unguarded)
    )
    assert without.max() > 100
    assert seen.sum() < without.sum() / 20


def fold(rig, frames: int) -> np.ndarray:
    """(frames, d) [rad] a knee that folds from rest to a right angle and more, the shin behind."""
    positions = np.tile(rig.rest, (frames, 1)).astype(np.float32)
    positions[:, rig.joint_names.index("lowerleg01.R_y")] += np.linspace(0, 2.0, frames, dtype=np.float32)
    return positions


def passed_by_shin(draper: Draper, pose: np.ndarray, cloth: np.ndarray) -> int:
    """How many vertices that hang behind the legs at rest are in the right shin or in front of it, up to 6 cm."""
    rig, bones = draper.layer.model.rig, draper.bone_transforms(pose)
    knee, ankle = (rig.bone_names.index(name) for name in ("lowerleg01.R", "foot.R"))
    heads = draper.avatar.bone_heads
    at = (cloth - bones[knee, :, 3]) @ bones[knee, :, :3] - heads[knee]
    down = (heads[ankle] - heads[knee]) / np.linalg.norm(heads[ankle] - heads[knee])
    along = at @ down
    forward, across = (at - along[:, None] * down)[:, :2].T
    beside = (np.abs(across) < 0.03) & (along > 0.1) & (along < 0.35)
    return int((beside & (forward > 0) & (forward < 0.06) & (draper.layer.bound.vertices[:, 0] < -0.05)).sum())


def test_a_shin_that_folds_takes_the_hem_along():
    """Half of what the skin's normals alone leave across the shin lies on the calf, though no network has moved it."""
    skirt = on_the_avatar(hanging_still("skirt"))
    rig, bound = skirt.layer.model.rig, skirt.layer.bound_visible
    motion = fold(rig, 12)
    by_normals = replace(bound, guard_ways=np.zeros_like(bound.guard_ways))
    led, left = (
        sum(passed_by_shin(skirt, pose, cloth) for pose, cloth in zip(motion, walked(skirt, each, motion)))
        for each in (bound, by_normals)
    )
    assert left > 10
    assert led < 0.55 * left


def blown(name, by):
    """A shipped garment that sways by the same (3,) [m] in every frame, wherever legs are."""
    model = swinging(name, 0.0)
    bias = np.tile(np.concatenate([np.zeros(9), by]), len(model.node_rest)).astype(np.float32)
    return replace(model, sway=replace(model.sway, out=(model.sway.out[0], bias)))


@pytest.mark.parametrize("by", [-0.2, pytest.param(0.2, marks=pytest.mark.slow)])
def test_cloth_that_is_blown_at_legs_does_not_go_through_them(by):
    """What hangs before a shin stays before it, where sway alone would take much of it to the other side."""
    skirt = on_the_avatar(blown("skirt", (by, 0.0, 0.0)))
    rig, bound = skirt.layer.model.rig, skirt.layer.bound_visible
    rest, knees = np.tile(rig.rest, (2, 1)), [rig.bone_names.index(f"lowerleg01.{side}") for side in "LR"]
    hung = on_the_avatar(replace(model_of("skirt"), sway=None)).drape(rig.rest)[:, :3]
    heads = skirt.avatar.bone_heads[knees]
    near = np.abs(hung[:, None, 1:] - heads[None, :, 1:]).max(axis=2).min(axis=1) < 0.02
    side = np.sign(hung[near, 0] - heads[:, 0].mean())
    guarded, free = (
        (np.sign(walked(skirt, each, rest)[-1, near, 0] - heads[:, 0].mean()) != side).sum()
        for each in (bound, bound.unguarded)
    )
    assert near.sum() > 20
    assert free > 5
    assert guarded == 0


@pytest.mark.parametrize("sways", [0, pytest.param(SWINGS, marks=pytest.mark.slow), 1.0])
@pytest.mark.parametrize("name", ["skirt", pytest.param("pencilskirt", marks=pytest.mark.slow), "widetrousers"])
def test_what_hangs_is_guarded_as_the_reference_does(name, sways):
    """In strides of a body that leans back or forward, so that cloth falls on its legs, or sways into them."""
    model = swinging(name, sways) if sways else model_of(name)
    bound = on_the_avatar(model).layer.bound
    reference, native, free = ReferenceFrame([bound]), NativeFrame([bound]), NativeFrame([bound.unguarded])
    told_of_time = {"sway": 1.0, "elapsed": 1 / RATE, "moves": 1.0} if sways else {}
    moved = 0.0
    motion = march(model.rig, 8) + fold(model.rig, 8) - model.rig.rest
    for pose, lean in zip(motion.astype(np.float32), 4 * [-0.8, 0.8]):
        row = told((0.0, 0.0, -1.0) if sways else (lean, 0.0, -0.6), **told_of_time)
        for frame in (reference, native, free):
            clouds(frame, [bound], pose, row)
        assert np.abs(native.node_transforms() - reference.node_transforms()).max() < 2e-5
        moved = max(moved, float(np.abs(free.node_transforms() - native.node_transforms()).max()))
    assert moved > 1e-4


def reached(rig, frames: int, back: float = 0.4) -> np.ndarray:
    """(frames, d) [rad] a left hand that goes from rest through the skirt, beside the hip, and back by so much
    [rad]."""
    positions = np.tile(rig.rest, (frames, 1)).astype(np.float32)
    for joint, by in (("clavicle.L_x", -0.25), ("upperarm01.L_x", -0.4), ("upperarm01.L_z", back)):
        positions[:, rig.joint_names.index(joint)] += by * np.linspace(0, 1, frames, dtype=np.float32)
    return positions


@pytest.fixture(scope="module")
def circleskirt():
    return on_the_avatar(replace(model_of("circleskirt"), sway=None))


def test_a_hand_presses_the_cloth_in(circleskirt):
    """A quarter less cloth is outside a hand that reaches into it, where it would hide the fingers."""
    rig, bound, avatar = circleskirt.layer.model.rig, circleskirt.layer.bound_visible, circleskirt.avatar
    motion = reached(rig, 12, back=0.5)
    undented = replace(bound, dent_shares=np.zeros_like(bound.dent_shares))
    wrist = rig.bone_names.index("wrist.L")
    hand = np.isin(avatar.influence_bones[:, 0], [k for k in range(len(rig.bone_names)) if wrist in rig.ancestors(k)])
    hides = np.zeros(2, dtype=int)
    for k, each in enumerate((bound, undented)):
        for pose, cloth in zip(motion, walked(circleskirt, each, motion)):
            middle = avatar.posed_vertices(circleskirt.bone_transforms(pose))[hand].mean(axis=0)
            away = cloth - middle
            hides[k] += int(((np.linalg.norm(away, axis=1) < 0.08) & (away[:, 1] > 0)).sum())
    assert hides[1] > 50
    assert hides[0] < 0.75 * hides[1]


def test_cloth_is_dented_as_the_reference_does(circleskirt):
    """By a hand that reaches into it, and by legs that garment nodes are too far apart for."""
    rig, bound = circleskirt.layer.model.rig, circleskirt.layer.bound
    reference, native = ReferenceFrame([bound]), NativeFrame([bound])
    undented = NativeFrame([replace(bound, dent_shares=np.zeros_like(bound.dent_shares))])
    dented = 0.0
    for pose in np.concatenate([reached(rig, 3), march(rig, 8)[1::2] + fold(rig, 4) - rig.rest]).astype(np.float32):
        seen, expected, without = (
            clouds(frame, [bound], pose, told((-0.8, 0.3, -0.6)))[0][:, :3] for frame in (native, reference, undented)
        )
        assert np.abs(seen - expected).max() < 1e-4
        dented = max(dented, float(np.abs(seen - without).max()))
    assert dented > 0.01


@pytest.mark.parametrize("name", ["longsleeve", "trousers"])
def test_what_neither_hangs_nor_sways_costs_nothing(name, worn):
    bound = worn(name).layers[0].bound
    assert len(bound.guard_vertices) == 0 and len(bound.skin_frames) == 0


def test_the_fitted_skin_is_near_the_skin(skirt):
    """At rest within millimetres on shins, and where a knee is folded."""
    avatar, rig, bound = skirt.avatar, skirt.layer.model.rig, skirt.layer.bound
    parts = fit_skin_parts(avatar, rig, find_limbs(rig))
    assert [part.presses for part in parts] == 7 * [False] + 4 * [True]
    shins = np.isin(
        avatar.influence_bones[:, 0], [k for k, name in enumerate(rig.bone_names) if name.startswith("lowerleg")]
    )
    depth = np.max([part.depth(avatar.vertices[shins].astype(np.float64)) for part in parts if part.is_shin], axis=0)
    assert np.quantile(np.abs(depth), 0.9) < 0.005
    folded = rig.rest.copy()
    folded[rig.joint_names.index("lowerleg01.R_y")] += 2.2
    bones = skirt.bone_transforms(folded).astype(np.float64)
    legs = np.isin(avatar.influence_bones[:, 0], [k for k, name in enumerate(rig.bone_names) if "leg" in name])
    skin = avatar.posed_vertices(bones.astype(np.float32))[legs].astype(np.float64)
    body = np.flatnonzero(bound.skin_presses == 0)
    depth = np.max([skin_depth(bound, part, bones, skin)[0] for part in body], axis=0)
    assert np.quantile(depth, 0.05) > -0.005


def test_heels_do_not_stand_out_of_the_fitted_skin(skirt):
    avatar, rig = skirt.avatar, skirt.layer.model.rig
    foot = rig.bone_names.index("foot.L")
    (part,) = (part for part in fit_skin_parts(avatar, rig, find_limbs(rig)) if part.bones == (foot,))
    skin = avatar.vertices[avatar.influence_bones[:, 0] == foot]
    heel = skin[skin[:, 0] < skin[:, 0].min() + 0.03].astype(np.float64)
    assert part.depth(heel).min() > -0.010


def test_samples_are_closer_together_where_heels_are():
    at = on_the_avatar(model_of("maxidress")).layer.bound.guard_vertices
    height = at[:, 2]
    apart = np.sort(np.linalg.norm(at[:, None] - at, axis=2), axis=1)[:, 1]
    low, shins = height < -0.75, (height > -0.55) & (height < -0.3)
    assert apart[low].mean() < 0.92 * apart[shins].mean()
