"""Cloth is kept out of the skin, of legs beneath it and of hands that press on it; nothing else is touched."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from random_models import random_avatar, random_model, random_rig, random_sway_network
from scipy.spatial import cKDTree

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model, load_motion
from physkin_core.model.garment import vertex_normals
from physkin_core.native_module import native
from physkin_core.quality import closest_points, edge_strain, signed_distance
from physkin_core.runtime import contact
from physkin_core.runtime.binding import bind_points
from physkin_core.runtime.contact import _spread as spread
from physkin_core.runtime.contact import meeting_skin

RATE = 30.0
INSIDE = 0.002
"""[m] A vertex deeper in the skin than this is seen through it."""
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


@cache
def bundled_avatar():
    return load_avatar(BUNDLED_AVATAR, model_of("skirt").rig)


def on_the_avatar(model):
    return Draper(model, bundled_avatar())


@pytest.fixture(scope="module")
def tshirt():
    return on_the_avatar(replace(model_of("tshirt"), sway=None))


def with_and_without(bound):
    """Of a bound garment, what drapes it by itself with contact, and without: (d,) and gravity to (n, 3)."""

    def draping(each):
        frame = NativeFrame([each])
        return lambda pose, gravity=(0, 0, -1): clouds(frame, [each], np.float32(pose), told(gravity))[0][:, :3]

    return draping(bound), draping(bound.without_contact)


def posed(rig, **joints):
    """(d,) float32 rest, and joints [rad] from there. A dot in a name is written as two underscores."""
    positions = np.array(rig.rest, dtype=np.float32)
    for name, by in joints.items():
        positions[rig.joint_names.index(name.replace("__", "."))] += by
    return positions


def march(rig, frames: int) -> np.ndarray:
    """(frames, d) [rad] thighs that swing to and fro twice a second, at rest in the first frame."""
    swing = 0.7 * np.sin(2 * np.pi * 2.0 * np.arange(frames) / RATE)
    return np.array([posed(rig, upperleg01__L_y=by, upperleg01__R_y=-by) for by in swing])


def walked(draper: Draper, bound, motion: np.ndarray) -> np.ndarray:
    """(frames, n, 3) the cloth in a motion, swaying in full."""
    outfit = draper.outfit.with_bound_garment(0, bound)
    root = np.array([0, 0, 0, 0, 0, 0, 1.0])
    return np.array(
        [outfit.drape(pose, time=k / RATE, root=root)[0][:, :3] for k, pose in enumerate(motion)], dtype=np.float64
    )


def skin_of(draper: Draper, *starts: str) -> np.ndarray:
    """(V,) bool, skin of bones whose names begin so, and of those after them."""
    rig, bones = draper.layer.model.rig, draper.avatar.influence_bones[:, 0]
    first = {k for k, name in enumerate(rig.bone_names) if name.startswith(starts)}
    return np.isin(bones, [k for k in range(len(rig.bone_names)) if first & set(rig.ancestors(k)) or k in first])


def inside(draper: Draper, pose, cloth: np.ndarray, part: np.ndarray, *, away: float = 0.0) -> int:
    """How many vertices are in a part of the skin, (V,) bool. away: [m] from where the body runs into itself: there
    is no room for cloth."""
    faces = draper.avatar.faces
    body = draper.avatar.posed_vertices(draper.bone_transforms(pose))
    distance = signed_distance(cloth, body, faces)
    nearest = distance if part.all() else signed_distance(cloth, body, faces[part[faces].all(axis=1)])
    seen = (distance < -INSIDE) & (np.abs(nearest) < np.abs(distance) + 1e-6)
    if away:
        blocked = body[signed_distance(body + 0.01 * vertex_normals(body, faces), body, faces) < 0]
        seen &= cKDTree(blocked).query(cloth)[0] > away if len(blocked) else True
    return int(seen.sum())


# --- Legs ---


def test_legs_that_march_stay_under_a_skirt_that_swings():
    """With sway that has not seen the motion: next to none inside where without contact there are many, and edges
    strain by no more than a fiftieth more."""
    skirt = on_the_avatar(swinging("skirt"))
    legs, motion = skin_of(skirt, "upperleg"), march(skirt.layer.model.rig, 16)
    cloths = [walked(skirt, bound, motion) for bound in (skirt.bound, skirt.bound.without_contact)]
    kept, free = ([inside(skirt, *at, legs) for at in zip(motion, cloth)] for cloth in cloths)
    assert max(free) > 10 and sum(free) > 30
    assert max(kept) <= 2
    strained, of_free = (edge_strain(skirt.layer.rest_garment, cloth).mean() for cloth in cloths)
    assert strained < 1.02 * of_free


def test_legs_stay_in_trousers_that_sway():
    """Shipped ones, each leg round its own: an eighth of what comes through without contact; the inner thighs, where
    both legs and two layers of cloth meet, have most of it."""
    trousers = on_the_avatar(model_of("widetrousers"))
    legs, motion = skin_of(trousers, "upperleg"), march(trousers.layer.model.rig, 16)
    kept, free = (
        sum(inside(trousers, *at, legs) for at in zip(motion, walked(trousers, bound, motion)))
        for bound in (trousers.bound, trousers.bound.without_contact)
    )
    assert free > 500
    assert kept < free / 8


def test_a_garment_without_detail_is_kept_out_by_garment_nodes():
    """By samples far from each other. Garment nodes leave what is less than 4 mm to detail, which it does not have, so
    that it is what is deeper that goes: of what is a centimetre in, four fifths."""
    skirt = on_the_avatar(replace(swinging("skirt"), detail=None))
    bound = skirt.bound
    assert len(bound.contact_gaps) == 1024 and len(bound.between_gaps) == 0 and bound.contact_detail_nodes.size == 0
    deep = np.zeros(2, dtype=int)
    for k, each in enumerate((bound, bound.without_contact)):
        motion = march(skirt.layer.model.rig, 16)
        for pose, cloth in zip(motion, walked(skirt, each, motion)):
            body = skirt.avatar.posed_vertices(skirt.bone_transforms(pose))
            deep[k] += (signed_distance(cloth, body, skirt.avatar.faces) < -0.01).sum()
    assert deep[1] > 100
    assert deep[0] < deep[1] / 5, deep


# --- Hands ---


def test_a_hand_that_presses_into_a_flared_skirt_is_not_through_the_cloth():
    """Beside the hip. A quarter fewer vertices are in it, and a quarter less cloth is outside of it, where it would
    the fingers."""
    skirt = on_the_avatar(replace(model_of("circleskirt"), sway=None))
    rig, hand = skirt.layer.model.rig, skin_of(skirt, "wrist.L")
    motion = [
        posed(rig, clavicle__L_x=-0.25 * by, upperarm01__L_x=-0.4 * by, upperarm01__L_z=0.5 * by)
        for by in np.linspace(0, 1, 12)
    ]
    in_it, hides = np.zeros(2, dtype=int), np.zeros(2, dtype=int)
    for k, drape in enumerate(with_and_without(skirt.bound)):
        for pose in motion:
            cloth = drape(pose)
            away = cloth - skirt.avatar.posed_vertices(skirt.bone_transforms(pose))[hand].mean(axis=0)
            in_it[k] += inside(skirt, pose, cloth, hand)
            hides[k] += ((np.linalg.norm(away, axis=1) < 0.08) & (away[:, 1] > 0)).sum()
    assert in_it[1] > 10 and hides[1] > 50
    assert in_it[0] < 0.75 * in_it[1], in_it
    assert hides[0] < 0.75 * hides[1], hides


def test_a_hand_on_the_belly_is_not_through_a_t_shirt(tshirt):
    """Flat on the cloth, which hangs there with some room: pressed in, it is beneath the hand."""
    rig, hand = tshirt.layer.model.rig, skin_of(tshirt, "wrist.L")
    pose = posed(
        rig,
        upperarm01__L_x=1.11,
        upperarm01__L_y=0.52,
        upperarm01__L_z=-1.21,
        upperarm02__L_y=0.54,
        lowerarm01__L_z=-1.17,
        lowerarm02__L_y=1.4,
        wrist__L_x=-0.03,
        wrist__L_z=0.15,
    )
    kept, free = (inside(tshirt, pose, drape(pose), hand, away=0.03) for drape in with_and_without(tshirt.bound))
    assert free > 10
    assert kept <= 1


# --- Motions ---


@pytest.mark.parametrize("name, every", [("kick", 6), ("dance", 9)])
def test_a_t_shirt_in_motions_is_in_the_skin_where_the_body_is_in_itself(name, every, tshirt):
    """Elsewhere less than a third of the vertices that are in it without contact."""
    motion, everywhere = load_motion(name), np.ones(len(tshirt.avatar.vertices), dtype=bool)
    poses, counts = motion.positions_for(tshirt.layer.model.rig), np.zeros(2, dtype=int)
    for k, drape in enumerate(with_and_without(tshirt.bound)):
        for pose, gravity in list(zip(poses, motion.gravity))[::every]:
            counts[k] += inside(tshirt, pose, drape(pose, gravity), everywhere, away=0.04)
    assert counts[1] > 15
    assert counts[0] < counts[1] / 3, counts


# --- What stays as it is ---


def test_a_t_shirt_at_rest_stays_as_it_is(tshirt):
    """It is moved from 2 mm before it must, so that contact begins without a kink: cloth that lies as near as at
    rest is to move by a quarter of that, 0.5 mm, in each of two passes. Beside creases detail nodes add up."""
    kept, free = (drape(tshirt.layer.model.rig.rest) for drape in with_and_without(tshirt.bound))
    moved = np.linalg.norm(kept - free, axis=1)
    assert np.quantile(moved, 0.999) < 0.001 and moved.max() < 0.002


def test_nothing_moves_where_nothing_lacks():
    """A raised thigh moves a skirt by millimetres, but what hangs a decimetre and more from all skin by less than
    a tenth of a millimetre, which garment nodes carry on. Where no skin presses nothing moves at all."""
    skirt = on_the_avatar(replace(model_of("skirt"), sway=None))
    for raised, most in ((0.9, 1e-4), (0.5, 1e-6)):
        pose = posed(skirt.layer.model.rig, upperleg01__L_y=-raised)
        kept, free = (drape(pose) for drape in with_and_without(skirt.bound))
        body = skirt.avatar.posed_vertices(skirt.bone_transforms(pose))
        far = signed_distance(free, body, skirt.avatar.faces) > 0.1
        moved = np.linalg.norm(kept - free, axis=1)
        assert far.sum() > 100 and moved.max() > 0.001
        assert moved[far].max() < most


def test_a_frame_that_stands_alone_is_the_same_whatever_came_before(tshirt):
    """Bit for bit."""
    motion = load_motion("kick")
    poses = np.float32(motion.positions_for(tshirt.layer.model.rig))
    fresh, used = (NativeFrame([tshirt.bound]) for _ in range(2))
    (expected,) = clouds(fresh, [tshirt.bound], poses[45], told())
    for pose in poses[:45:9]:
        clouds(used, [tshirt.bound], pose, told(passed=1 / 30))
    assert (clouds(used, [tshirt.bound], poses[45], told())[0] == expected).all()


def test_points_go_along(tshirt):
    """Those on vertices are where these are, in a pose in which contact moves them by millimetres."""
    motion = load_motion("dance")
    pose = motion.positions_for(tshirt.layer.model.rig)[75]
    chosen = slice(None, None, 7)
    model, bound = tshirt.layer.model, tshirt.bound
    points = bind_points(model, model.garment.vertices[chosen], rest=bound.vertices)
    kept, free = (drape(pose, motion.gravity[75]) for drape in with_and_without(bound))
    found, _ = (drape(pose, motion.gravity[75]) for drape in with_and_without(replace(bound, **points)))
    assert np.abs(kept - free)[chosen].max() > 0.004
    assert np.abs(found - kept[chosen]).max() < 1e-4


@pytest.mark.filterwarnings("ignore::physkin_core.AvatarWarning")
def test_a_rig_without_limbs_works():
    """All of its skin is one part, beneath the cloth."""
    rng = np.random.default_rng(5)
    rig = random_rig(rng)
    bound = Draper(random_model(rng, rig=rig, detail_nodes=20), random_avatar(rng, rig)).bound
    assert len(bound.skin_positions) > 0 and (bound.contact_sides >= 0).all()
    for drape in with_and_without(bound):
        assert np.isfinite(drape(rig.rest)).all()


def test_a_body_whose_limbs_are_not_found_is_met(tshirt, monkeypatch):
    """Less than half of the vertices that are in the skin without contact, in a frame of a dance."""

    def none(rig):
        raise ValueError("no limbs")

    monkeypatch.setattr("physkin_core.runtime.contact.find_limbs", none)
    bound = replace(tshirt.bound, **meeting_skin(tshirt.bound.without_contact, tshirt.avatar, tshirt.model.rig))
    motion, everywhere = load_motion("dance"), np.ones(len(tshirt.avatar.vertices), dtype=bool)
    pose, gravity = motion.positions_for(tshirt.model.rig)[75], motion.gravity[75]
    kept, free = (
        inside(tshirt, pose, drape(pose, gravity), everywhere, away=0.04) for drape in with_and_without(bound)
    )
    assert (bound.contact_sides >= 0).all() and not (tshirt.bound.contact_sides >= 0).all()
    assert free > 5
    assert kept < free / 2, (kept, free)


# --- Cloth and itself ---


def block_of_cloth(at, facing):
    """(16, 6) a sheet, 2 cm from sample to sample, at a place and across a unit normal along an axis."""
    facing = np.array(facing, dtype=float)
    sheet = 0.02 * np.stack(np.meshgrid(range(4), range(4)), axis=2).reshape(-1, 2)
    places = np.insert(sheet, np.abs(facing).argmax(), 0, axis=1)
    return np.concatenate([places + at, np.tile(facing, (16, 1))], axis=1)


LEGS = contact.Parts(
    *(np.array(of) for of in ([0], [-1, 0, 0, 1, 1], [False] * 5, [False, True, False] * 1 + [True, False]))
)


def skin_beneath(*blocks, part):
    """Skin beneath such blocks, 1 cm off."""
    cloth = np.concatenate(blocks)
    points, none = cloth[:, :3] - 0.01 * cloth[:, 3:], np.zeros((len(cloth), 1))
    return contact.Skin(points, cloth[:, 3:], none, none, np.repeat(part, 16))


def test_legs_of_trousers_press_on_each_other_where_their_outsides_face():
    """What faces away from the other leg is in no block."""
    left, right = block_of_cloth((0, 0.1, 0), (0, -1, 0)), block_of_cloth((0, -0.1, 0), (0, 1, 0))
    outer = block_of_cloth((0, 0.3, 0), (0, 1, 0))
    cloth, skin = np.concatenate([left, right, outer]), skin_beneath(left, right, outer, part=[1, 3, 1])
    found = contact._touching(cloth, np.arange(48)[:, None], skin, LEGS)
    assert sorted(found["touching_samples"]) == list(range(32))
    assert found["touching_sides"].tolist() == [[0, -1], [-1, 0]]


def test_layers_of_the_cloth_keep_the_order_they_were_made_in():
    """Over and beneath each other on one leg, and far from each other along the cloth."""
    beneath, over = block_of_cloth((0, 0, 0), (0, 1, 0)), block_of_cloth((0, 0.005, 0), (0, 1, 0))
    cloth, skin = np.concatenate([beneath, over]), skin_beneath(beneath, over, part=[1, 1])
    found = contact._touching(cloth, np.arange(32)[:, None], skin, LEGS)
    assert sorted(found["touching_samples"][:16]) == list(range(16, 32))
    assert found["touching_sides"].tolist() == [[0, 1], [2, 0]]
    assert not len(contact._touching(cloth, np.zeros((32, 1), dtype=int), skin, LEGS)["touching_samples"])


def test_cloth_whose_outside_faces_the_body_is_turned_around(tshirt, monkeypatch):
    """As a collar's fall is: there, and only there, samples face the other way than their vertices."""
    rest = tshirt.layer.rest
    turned = rest[:, 2] > np.quantile(rest[:, 2], 0.9)
    monkeypatch.setattr(contact, "turned_cloth", lambda *_: turned)
    fields = meeting_skin(tshirt.bound, tshirt.avatar, tshirt.layer.model.rig)
    number = {vertex.tobytes(): k for k, vertex in enumerate(tshirt.bound.vertices)}
    samples = np.array([number[vertex.tobytes()] for vertex in fields["contact_vertices"]])
    flipped = (fields["contact_normals"] * tshirt.bound.normals[samples]).sum(axis=1) < 0
    np.testing.assert_array_equal(flipped, turned[samples])
    assert 50 < flipped.sum() < len(samples) / 2


def test_shipped_trousers_keep_their_legs_apart():
    """In a walk, samples of one leg are less deep in the cloth of the other, all together by a third at least."""
    draper, motion = on_the_avatar(replace(model_of("trousers"), sway=None)), load_motion("walk")
    bound, poses = draper.bound, np.float32(motion.positions_for(draper.model.rig))[::6]
    frames = NativeFrame([bound]), NativeFrame([replace(bound, touching_gaps=np.full_like(bound.touching_gaps, -1))])
    crossed = [0, 0]
    for pose in poses:
        for k, frame in enumerate(frames):
            clouds(frame, [bound], pose, told())
            crossed[k] += np.maximum(-frame.clearance()[len(bound.vertices) :], 0).sum()
    assert crossed[1] > 0.05 and crossed[0] < 2 / 3 * crossed[1], crossed


# --- Figures and symmetry ---


@pytest.mark.parametrize("frame", [None, 75])
def test_clearance_is_how_far_samples_are_from_the_skin(frame, tshirt):
    """Within 2 cm. Planes at points 3 cm apart are off a skin that bends by a radius of 10 cm by up to 1.1 mm, more
    in folds: half of the samples are off by less than 2 mm, nineteen in twenty by less than 8 mm."""
    motion, bound, rig = load_motion("dance"), tshirt.bound, tshirt.layer.model.rig
    pose, gravity = (
        (rig.rest, (0, 0, -1)) if frame is None else (motion.positions_for(rig)[frame], motion.gravity[frame])
    )
    native = NativeFrame([bound])
    (cloud,) = clouds(native, [bound], np.float32(pose), told(gravity))
    number = {vertex.tobytes(): k for k, vertex in enumerate(bound.vertices)}
    samples = [number[vertex.tobytes()] for vertex in bound.contact_vertices]
    assert len(native.clearance()) - len(bound.touching_gaps) == len(bound.vertices)
    assert len(samples) + len(bound.between_gaps) == len(bound.vertices)
    body = tshirt.avatar.posed_vertices(tshirt.bone_transforms(np.float32(pose)))
    distance = signed_distance(cloud[samples, :3], body, tshirt.avatar.faces)
    off = np.abs(native.clearance()[: len(samples)] - distance)[np.abs(distance) < 0.02]
    assert len(off) > 400 and np.median(off) < 0.002 and np.quantile(off, 0.95) < 0.008
    assert NativeFrame([bound.without_contact]).clearance().shape == (0,)


def test_cloth_that_no_skin_is_near_is_a_metre_from_it_and_keeps_off_in_full():
    """The hem of a dress at rest: a quarter of a metre and more from the legs."""
    dress = on_the_avatar(replace(model_of("maxidress"), sway=None))
    bound, native = dress.bound, NativeFrame([dress.bound])
    (cloud,) = clouds(native, [bound], np.float32(dress.layer.model.rig.rest), told())
    number = {vertex.tobytes(): k for k, vertex in enumerate(bound.vertices)}
    samples = [number[vertex.tobytes()] for vertex in bound.contact_vertices]
    far = signed_distance(cloud[samples, :3], dress.avatar.vertices, dress.avatar.faces) > 0.1
    assert far.sum() > 100
    assert (native.clearance()[: len(samples)][far] == 1).all()
    np.testing.assert_allclose(bound.contact_gaps[far], 0.003)


def mirrored(rig, pose):
    """The other side's joints; what turns about a sideways axis turns the same way, all else the other."""
    other = {".L_": ".R_", ".R_": ".L_"}
    names = [next((name.replace(a, b) for a, b in other.items() if a in name), name) for name in rig.joint_names]
    signs = [1 if name.endswith("_y") else -1 for name in names]
    return np.float32(np.array(signs) * pose[[rig.joint_names.index(name) for name in names]])


@pytest.mark.parametrize("frame", [0, 75])
def test_mirrored_poses_give_mirrored_drapes(frame, tshirt):
    """As far as networks do: their drapes differ by 2 to 3 mm on average. The points of the skin are not mirrored,
    and each is right to a millimetre (see above), of which cloth where there is contact gets its share."""
    motion, rig, mirror = load_motion("dance"), tshirt.layer.model.rig, np.array([1, -1, 1])
    pose, gravity = motion.positions_for(rig)[frame], motion.gravity[frame]
    apart, counts, everywhere = [], [], np.ones(len(tshirt.avatar.vertices), dtype=bool)
    for drape in with_and_without(tshirt.bound):
        cloth, other = drape(pose, gravity), drape(mirrored(rig, pose), gravity * mirror)
        apart.append(closest_points(cloth * mirror, other, tshirt.layer.rest_garment.faces)[0].mean())
        counts.append([inside(tshirt, *at, everywhere) for at in ((pose, cloth), (mirrored(rig, pose), other))])
    assert apart[1] < 0.004
    assert apart[0] < apart[1] + 0.0005
    assert abs(counts[0][0] - counts[0][1]) < 0.25 * sum(counts[1]), counts


def test_points_of_the_skin_are_each_the_farthest_from_those_before():
    """As where all are looked at every time; also of few points, and where points coincide."""
    rng = np.random.default_rng(0)
    for count, wanted in ((3000, 400), (65, 65), (7, 5)):
        points = rng.normal(size=(count, 6))
        chosen, distance = [0], np.full(count, np.inf)
        while len(chosen) < wanted:
            distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
            chosen.append(int(distance.argmax()))
        assert spread(points, wanted).tolist() == chosen
    assert spread(np.zeros((70, 3)), 3)[0] == 0
    with pytest.raises(ValueError, match="more points are to be chosen"):
        native.spread_points(np.zeros((2, 3)), np.zeros(3, dtype=np.int32))
