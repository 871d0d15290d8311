"""Garments with a sway network: oscillators of the reference, and drapes that are told time and root."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from random_models import random_sway_network
from reference.frame_input import FrameInput
from reference.sway_network import SwayNetwork
from scipy.spatial.transform import Rotation

import physkin_core as physkin
from physkin_core.model.sway_network import fold_body

DOFS, NODES = 9, 5


@pytest.fixture
def sway():
    rng = np.random.default_rng(0)
    bound = fold_body(random_sway_network(rng, DOFS, NODES, modulation=6), rng.normal(size=6))
    limits = {"dof_lower": -np.ones(DOFS), "dof_upper": np.ones(DOFS)}
    return lambda: SwayNetwork(SimpleNamespace(**limits, **bound, sway_thighs=()))


POSE, OTHER, DOWN = np.linspace(-0.5, 0.6, DOFS), np.linspace(0.4, -0.3, DOFS), np.array([0.0, 0.6, -0.8])


def row(elapsed, *, moves=1.0, velocity=(0.5, -0.2, 0.1), turning=(0.1, 0.3, -2.0)):
    return FrameInput(DOWN, elapsed, 1.0, elapsed, moves, np.array(velocity), np.array(turning))


def test_a_step_is_as_far_as_two_of_half_the_time(sway):
    """Where features do not change: gaps at one pose, or steady turning of a body that holds one."""
    for told in ({"moves": 0.0}, {"velocity": (1.0, 0.0, 0.0)}):
        whole, halves = sway(), sway()
        for each in (whole, halves):
            each.offsets(POSE, row(-1.0))
            each.offsets(OTHER, row(1 / 30))
            each.offsets(OTHER, row(1 / 30, **told))
        once = whole.offsets(OTHER, row(0.08, **told))
        halves.offsets(OTHER, row(0.04, **told))
        np.testing.assert_allclose(halves.offsets(OTHER, row(0.04, **told)), once, rtol=0, atol=1e-12)


def test_the_first_frame_is_at_rest_and_rest_is_where_it_returns(sway):
    still = sway()
    first = still.offsets(OTHER, row(-1.0))
    assert np.abs(still.offsets(OTHER, row(0.5, moves=0.0)) - first).max() < 1e-12
    swung = sway()
    swung.offsets(POSE, row(-1.0))
    away = [
        swung.offsets(OTHER, row(1 / 60)),
        *(swung.offsets(OTHER, row(1.0, moves=0.0)) for _ in range(40)),
    ]
    assert np.abs(away[0] - first).max() > 0.01
    assert np.abs(away[-1] - first).max() < 1e-6


def test_a_doubled_stamp_shows_the_pose_and_moves_nothing_on(sway):
    once, twice = sway(), sway()
    for each in (once, twice):
        each.offsets(POSE, row(-1.0))
        found = each.offsets(OTHER, row(1 / 60))
    assert (twice.offsets(OTHER, row(0.0, velocity=(9.0, 9.0, 9.0))) == found).all()
    assert np.abs(twice.offsets(POSE, row(0.0)) - found).max() > 1e-3, "a part of the pose came late"
    twice.offsets(OTHER, row(0.0))
    assert (twice.offsets(POSE, row(0.02)) == once.offsets(POSE, row(0.02))).all()


def test_forgotten_it_begins_anew(sway):
    used, fresh = sway(), sway()
    used.offsets(POSE, row(-1.0))
    used.forget()
    assert (used.offsets(OTHER, row(1 / 60)) == fresh.offsets(OTHER, row(-1.0))).all()


# --- Drapes ---


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
    rig, bound = plain.model.rig, bound_to(swaying, plain).bound.unguarded
    thighs = np.array([k for k, name in enumerate(rig.bone_names) if name.startswith("upperleg01")], dtype=np.int32)
    lying, free, still = (copy(plain) for _ in range(3))
    for draper, worn in ((lying, replace(bound, sway_thighs=thighs)), (free, bound), (still, plain.bound.unguarded)):
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
    free = bound_to(swaying, exact).layer.bound_visible.unguarded
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


def test_garments_of_an_outfit_sway_each_in_its_way(plain, swaying):
    """A shirt without a network not at all, the skirt by its network, half as much: as single drapers."""
    shirt = replace(physkin.load_garment_model("tshirt"), sway=None)
    outfit = physkin.Outfit([swaying, shirt], plain.avatar, hide_covered=False)
    outfit.sway = (0.5, 1.0)
    singles = [
        physkin.Outfit([layer.model], plain.avatar).with_bound_garment(0, layer.bound_visible)
        for layer in outfit.layers
    ]
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
