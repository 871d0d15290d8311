"""Drapes that are told time, root and wind: cloth keeps a pace, is blown, and sways by its network."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from random_models import random_sway_network
from scipy.spatial.transform import Rotation

import physkin_core as physkin
from physkin_core.model.sway_network import fold_body
from physkin_core.runtime.frame_input import AIR_DRAG, STANDARD_GRAVITY

STANDING = (0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def plain():
    model = replace(physkin.load_garment_model("skirt"), sway=None)
    return physkin.Draper(model, physkin.load_avatar(physkin.BUNDLED_AVATAR, model.rig))


@pytest.fixture(scope="module")
def swaying(plain):
    """The skirt with a random sway network."""
    model = plain.model
    modulation = 2 * sum(len(bias) for _, bias in model.pose_modulator[:-1])
    network = random_sway_network(
        np.random.default_rng(1), len(model.rig.dofs), len(model.node_rest), modulation=modulation, offset=0.02
    )
    return replace(model, sway=network)


@pytest.fixture
def skirt(plain, swaying):
    """One that the random sway network moves."""
    return bound_to(swaying, plain)


def with_frames_of_its_own(draper):
    """The same garment as in its first frame; nothing is bound anew."""
    other = copy(draper)
    other.outfit = draper.outfit.twin()
    return other


def bound_to(swaying, plain):
    """A draper that sways by the network, with frames of its own; nothing is bound anew."""
    draper, network = copy(plain), fold_body(swaying.sway, swaying.sway.code_mean)
    draper.outfit = plain.outfit.with_bound_garment(0, replace(plain.bound, **network))
    return draper


def walking(count, rate=30.0):
    motion = physkin.load_motion("walk")
    roots = np.concatenate([motion.root_position, motion.root_orientation], axis=1)
    frames = (np.arange(count) * motion.rate_hz / rate).astype(int)
    positions = motion.positions_for(physkin.load_garment_model("skirt").rig)
    return [(positions[f], {"time": k / rate, "root": roots[f]}) for k, f in enumerate(frames)]


def test_it_sways_by_the_network_alone(plain, swaying):
    """Where that gives nothing, or there is none, it is the drape of a root at rest, however that moves."""
    weight, bias = swaying.sway.out
    silent = replace(swaying, sway=replace(swaying.sway, out=(0 * weight, 0 * bias)))
    (still, told), *_ = reversed(walking(20))
    quiet, loud = bound_to(silent, plain), bound_to(swaying, plain)
    for k in range(12):
        moved = {"time": k / 30, "root": (0.02 * k * k, 0, 0.9, *Rotation.from_euler("z", 0.1 * k).as_quat())}
        of_nothing, swung, of_none = (each.drape(still, **moved) for each in (quiet, loud, plain))
    at_rest = plain.drape(still)
    assert np.abs(of_nothing - at_rest).max() < 2e-5 and np.abs(of_none - at_rest).max() < 2e-5
    assert np.abs(swung - at_rest).max() > 1e-3


def test_cloth_that_lies_on_a_raised_thigh_sways_no_longer(plain, swaying):
    """But it hangs from the knees of one who sits."""
    rig, bound = plain.model.rig, bound_to(swaying, plain).bound.without_contact
    thighs = np.array([k for k, name in enumerate(rig.bone_names) if name.startswith("upperleg01")], dtype=np.int32)
    lying, free, still = (copy(plain) for _ in range(3))
    for draper, worn in (
        (lying, replace(bound, sway_thighs=thighs)),
        (free, bound),
        (still, plain.bound.without_contact),
    ):
        draper.outfit = draper.outfit.with_bound_garment(0, worn)
    left = []
    for left_thigh, right_thigh in ((0, 0), (20, 0), (45, 0), (70, 0), (70, 70)):
        pose = rig.rest.copy()
        for side, degrees in (("L", left_thigh), ("R", right_thigh)):
            pose[rig.joint_names.index(f"upperleg01.{side}_y")] -= np.radians(degrees)
        for k in range(6):
            swung = [d.drape(pose, time=k / 30, root=(0.02 * k * k, 0, 0.9, 0, 0, 0, 1)).copy() for d in (lying, free)]
        held, full = (np.abs(each - still.drape(pose))[:, :3].max() for each in swung)
        left.append(held / full)
        lying.reset()
        free.reset()
    assert full > 1e-3 and left[0] == left[4] == pytest.approx(1)
    assert left[1] > 0.9 and 0 < left[2] < 0.7 and left[3] < 1e-5


def test_without_time_or_sway_it_is_the_drape_bit_for_bit(plain, swaying):
    draper = bound_to(swaying, plain)
    draper.sway = 0.0
    for positions, told in walking(3):
        down = Rotation.from_quat(told["root"][3:]).inv().apply([0, 0, -1])
        assert (draper.drape(positions, down) == plain.drape(positions, down)).all()
        given = {"time": told["time"]}
        assert (draper.drape(positions, down, **given) == plain.drape(positions, down)).all()
    draper.sway = 1.0
    assert np.abs(draper.drape(positions, **told) - plain.drape(positions, down)).max() > 1e-3
    assert (draper.drape(positions, down) == plain.drape(positions, down)).all()


def test_half_the_sway_is_half_the_offsets(plain, swaying):
    """But where cloth meets a leg."""
    exact = physkin.Draper(plain.model, plain.avatar, precision="fp32")
    free = bound_to(swaying, exact).layer.bound_visible.without_contact
    whole, half = (bound_to(swaying, exact).outfit.with_bound_garment(0, free) for _ in range(2))
    half.sway = 0.5
    for positions, told in walking(4):
        down = Rotation.from_quat(told["root"][3:]).inv().apply([0, 0, -1])
        whole.drape(positions, **told), half.drape(positions, **told)
    offsets = [each.node_transforms()[0] for each in (whole, half)]
    whole.drape(positions, down)
    far, near = (each - whole.node_transforms()[0] for each in offsets)
    assert np.abs(near - far / 2).max() < 1e-3 * np.abs(far).max() + 1e-5


def test_drapers_of_one_model_share_no_state(plain, swaying):
    frames = walking(10)
    alone, one, other = (bound_to(swaying, plain) for _ in range(3))
    for k, (positions, told) in enumerate(frames):
        expected, found = alone.drape(positions, **told), one.drape(positions, **told)
        other.drape(frames[-k][0], time=told["time"], root=frames[-k][1]["root"])
        assert (found == expected).all()
    one.reset(), other.reset()
    assert (one.drape(*frames[3][:1], **frames[3][1]) == other.drape(*frames[3][:1], **frames[3][1])).all()


def test_a_time_without_a_root_moves_by_the_joints_alone(plain, swaying):
    """As a root that stays where it is."""
    told, rooted = bound_to(swaying, plain), bound_to(swaying, plain)
    for k, (positions, _) in enumerate(walking(8)):
        found = told.drape(positions, (0, 0, -1), time=k / 30)
        expected = rooted.drape(positions, time=k / 30, root=(3.0, 1.0, 0.9, 0, 0, 0, 1))
        if k > 1:  # the root is not known to stay before there are two frames of it
            assert np.abs(found - expected).max() < 1e-3
    assert np.abs(found - plain.drape(positions)).max() > 1e-3


def test_under_effective_gravity_it_sways_as_of_a_root_that_does_not_turn_or_move(plain, swaying):
    """As under that direction of gravity; and an acceleration that comes and goes swings it."""
    drapers, frames = [bound_to(swaying, plain) for _ in range(3)], walking(10)
    for k, (positions, _) in enumerate(frames):
        down = np.array([0.1 * k / 10, 0.0, -1.0]) / np.hypot(0.1 * k / 10, 1.0)
        given = drapers[0].drape(positions, time=k / 30, effective_gravity=9.81 * down)
        assert np.abs(given - drapers[1].drape(positions, down, time=k / 30)).max() < 1e-5
        pushed = drapers[2].drape(positions, time=k / 30, effective_gravity=9.81 * down + [3.0 * (k % 5 > 2), 0, 0])
    assert np.abs(given - plain.drape(positions, down)).max() > 1e-3
    leaning = drapers[0].drape(positions, time=k / 30, effective_gravity=9.81 * down + [3, 0, 0])
    assert np.abs(pushed - leaning).max() > 1e-3


def test_wind_swings_it(plain, swaying):
    """As gravity that changes: after a gust it comes to rest where wind lets it hang."""
    draper, rest, path = bound_to(swaying, plain), swaying.rig.rest, []
    for k in range(240):
        draper.wind = (-8.0 * (k >= 20), 0.0, 0.0)
        path.append(draper.drape(rest, time=k / 30, root=(0, 0, 0.9, 0, 0, 0, 1))[:, :3])
    changes = np.abs(np.diff(path, axis=0)).max(axis=(1, 2))
    assert changes[:18].max() < 1e-5 < 1e-3 < changes[20:40].max() and changes[-20:].max() < 1e-5
    first = bound_to(swaying, plain)
    first.wind = draper.wind
    assert np.abs(first.drape(rest, time=0.0, root=(0, 0, 0.9, 0, 0, 0, 1))[:, :3] - path[-1]).max() < 1e-3


@pytest.mark.parametrize("disturbance", ["gap", "jump", "back", "twice"])
def test_disturbed_messages_do_not_pop(disturbance, plain, swaying):
    """Of a body that strolls, no frame's cloth is farther from the last than twice as far as undisturbed; what the pace
    would keep is looked at, too: garment nodes before it."""
    draper, rest, last, changes, time, shift = bound_to(swaying, plain), swaying.rig.rest, None, [], 0.0, 0.0
    for k in range(60):
        time += 1 / 30
        if k == 30:
            time += {"gap": 2.0, "back": -5.0}.get(disturbance, 0.0)
            shift += 20.0 * (disturbance == "jump")
        root = (1.2 * k / 30 + shift, 0.05 * np.sin(8 * k / 30), 0.9, *Rotation.from_euler("z", 0.02 * k).as_quat())
        cloud = draper.drape(rest, time=time, root=root)
        if disturbance == "twice":
            assert np.abs(draper.drape(rest, time=time, root=root) - cloud).max() < 1e-6
        if last is not None:
            changes.append(np.abs(cloud - last)[:, :3].max())
        last = cloud
    assert max(changes[5:29]) > 1e-5
    allowed = 0.02 if disturbance in ("gap", "jump") else 2 * max(changes[2:29])
    assert max(changes[29:]) < allowed


def test_garments_of_an_outfit_sway_each_by_itself(plain, swaying, worn):
    """A shirt without a network not at all, the skirt by its network, half as much: as single drapers."""
    shirt = replace(physkin.load_garment_model("tshirt"), sway=None)
    outfit = physkin.Outfit([swaying, shirt], plain.avatar, hide_covered=False)
    outfit.sway = (0.5, 1.0)
    alone = zip((plain.outfit, worn("tshirt")), outfit.layers)
    singles = [single.with_bound_garment(0, layer.bound_visible) for single, layer in alone]
    singles[0].sway = 0.5
    for positions, told in walking(30):
        told["time"] += 0.5 * (told["time"] > 0.2)
        outfit.drape(positions, **told)
        for nodes, single in zip(outfit.node_transforms(), singles):
            single.drape(positions, **told)
            assert np.abs(nodes - single.node_transforms()[0]).max() < 1e-5
    for single, sways in zip(singles, (True, False)):
        (moved,) = single.node_transforms()
        single.drape(positions, Rotation.from_quat(told["root"][3:]).inv().apply([0, 0, -1]))
        assert (np.abs(moved - single.node_transforms()[0]).max() > 1e-3) == sways
    outfit.reset(), singles[0].reset()
    outfit.drape(positions, **told), singles[0].drape(positions, **told)
    assert np.abs(outfit.node_transforms()[0] - singles[0].node_transforms()[0]).max() < 1e-5


def test_after_a_stop_a_skirt_swings_on_and_hangs_still(skirt):
    rest, path = skirt.model.rig.rest, []
    for k in range(330):
        path.append(skirt.drape(rest, time=k / 60, root=(1.4 * min(k / 60, 2.0), 0, 0.9, 0, 0, 0, 1))[:, :3])
    changes = np.abs(np.diff(path, axis=0)).max(axis=(1, 2))
    assert changes[121:150].max() > 2e-4 and changes[-30:].max() < 1e-5
    skirt.reset()
    still = skirt.drape(rest, time=0.0, root=(0, 0, 0.9, 0, 0, 0, 1))
    assert np.abs(path[-1] - still[:, :3]).max() < 5e-4
    assert np.abs(path[100] - still[:, :3]).max() > 1e-3


def test_a_garment_without_a_network_is_draped_at_rest_however_the_root_moves(plain):
    """At any rate, over gaps, jumps, doubled messages and clocks that go back."""
    draper, rest, generator, time = with_frames_of_its_own(plain), plain.model.rig.rest, np.random.default_rng(4), 0.0
    at_rest = plain.drape(rest)
    for _ in range(60):
        time += generator.choice([1 / 120, 1 / 60, 1 / 15, 0.0, 0.5, -2.0])
        turn = Rotation.from_euler("z", generator.normal()).as_quat()
        moved = draper.drape(rest, time=time, root=(*generator.normal(size=3), *turn))
        assert np.abs(moved - at_rest).max() < 1e-5


def test_the_root_tells_gravity(skirt):
    skirt.reset()
    turn = Rotation.from_euler("y", 0.6)
    rest, down = skirt.model.rig.rest, turn.inv().apply([0, 0, -1])
    leaning = skirt.drape(rest, time=0.0, root=(0, 0, 0, *turn.as_quat()))
    skirt.reset()
    assert np.allclose(leaning, skirt.drape(rest, down, time=0.0), atol=1e-5)


@pytest.mark.parametrize(
    "given",
    [
        {"root": (0, 0, 0, 0, 0, 0, 1)},
        {"time": 0.0, "root": (0,) * 6 + (1,), "effective_gravity": (0, 0, -9.81)},
    ],
)
def test_a_root_comes_with_a_time_and_without_gravity(skirt, given):
    with pytest.raises(ValueError, match="time with root"):
        skirt.drape(skirt.model.rig.rest, **given)


def test_a_drape_without_a_time_ends_what_was_before(skirt):
    """The next one with a time is as a first one: nothing swings on, and no pace is kept."""
    rest = skirt.model.rig.rest
    root = (0.5, 0, 0.9, 0, 0, 0, 1)
    skirt.reset()
    first = skirt.drape(rest, time=0.0, root=root)
    for k in range(20):
        swung = skirt.drape(rest, time=k / 60, root=(0.5 * k / 20, 0, 0.9, 0, 0, 0, 1))
    skirt.drape(rest)
    assert np.abs(swung - first).max() > 0.005
    assert np.allclose(skirt.drape(rest, time=20 / 60, root=root), first, atol=1e-5)
    skirt.sway = 0.0
    tilted = skirt.drape(rest, (0.45, 0.0, -0.9))
    skirt.drape(rest)
    assert (skirt.drape(rest, (0.45, 0.0, -0.9), time=21 / 60) == tilted).all()


def test_what_an_outfit_takes_for_its_sway(plain):
    """One number for all garments, or one for each; a twin keeps it, and the wind."""
    outfit = plain.outfit.twin()
    outfit.wind = (3.0, -2.0, 0.5)
    assert outfit.twin().wind == outfit.wind == (3.0, -2.0, 0.5)
    for given in (0.5, np.float32(0.5), np.array([0.5], dtype=np.float32), [np.float64(0.5)]):
        outfit.sway = given
        assert outfit.sway == outfit.twin().sway == 0.5
        outfit.sway = 1.0
    for wrong in (1.5, (0.5, -0.1), "all", (0.5, 0.5), np.array(0.5), [[0.5]], None):
        with pytest.raises(ValueError, match="a number from 0 to 1|one for each of 1"):
            outfit.sway = wrong
    assert outfit.sway == 1.0


def test_a_skirt_is_blown_with_the_wind_as_an_acceleration_leans_it(plain):
    skirt = with_frames_of_its_own(plain)
    rest = skirt.model.rig.rest
    skirt.wind = (-4.0, 0.0, 0.0)
    found = skirt.drape(rest)
    skirt.wind = (0.0, 0.0, 0.0)
    expected = skirt.drape(rest, effective_gravity=(-4.0 * AIR_DRAG, 0.0, -STANDARD_GRAVITY))
    assert np.abs(found - expected).max() < 1e-5
    hem = skirt.rest_garment.vertices[:, 2] < skirt.rest_garment.vertices[:, 2].min() + 0.1
    assert (found - skirt.drape(rest))[hem, 0].mean() < -0.008


def test_a_sudden_gust_does_not_let_cloth_leap(plain):
    skirt = with_frames_of_its_own(plain)
    rest, last, steps = skirt.model.rig.rest, None, []
    for k in range(90):
        if k == 20:
            skirt.wind = (-10.0, 4.0, 0.0)
        cloth = skirt.drape(rest, time=k / 60, root=STANDING)[:, :3]
        steps.append(0.0 if last is None else np.abs(cloth - last).max())
        last = cloth
    assert np.abs(last - skirt.drape(rest)[:, :3]).max() < 1e-3
    assert 0.001 < max(steps) < 0.005
