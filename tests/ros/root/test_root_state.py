"""What a frame is given of a root, draped beside drapers and outfits that are told the same times and roots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_avatar, random_model, tube
from scipy.spatial.transform import Rotation

from physkin_core import Draper, FrameInput, Outfit
from physkin_core.sway.frame_input import STANDARD_GRAVITY
from physkin_ros.root.gravity import FRESH, EffectiveGravity
from physkin_ros.root.root_motion import RootMotion
from physkin_ros.root.root_state import RootState

DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)
MILLISECOND = 1_000_000
TIMES = np.cumsum([1000, *[16] * 12, 0, 16, 16, 50, 7, 400, *[16] * 6, -5000, *[33] * 8]) * MILLISECOND
"""Stamps [ns]: frames at several rates, a doubled one, a gap, a clock that goes back."""


@pytest.fixture(scope="module")
def drapers():
    """One with a sway network and one without, of one rig and body."""
    rng = np.random.default_rng(3)
    learnt = random_model(rng, learnt_sway=True)
    other = random_model(rng, rig=learnt.rig)
    avatar = random_avatar(rng, learnt.rig)
    return [Draper(replace(model, name=name), avatar, precision="fp32")
            for name, model in (("learnt", learnt), ("other", other))]  # fmt: skip


@pytest.fixture
def outfit(drapers):
    """Frames of their own, of the garment with the network."""
    return drapers[0].outfit.twin()


def state_of(*outfits: Outfit) -> RootState:
    """Of an avatar in these outfits, which do not know each other."""
    return RootState(DOWN, FrameInput(sum(len(outfit.layers) for outfit in outfits)))


def bound(state: RootState, outfit: Outfit, row: int = 0):
    """Drapes a joint state [ns] of a pose by what the rows from this one on say then."""
    inputs = state.frame_input.rows[row : row + len(outfit.layers)]
    positions = np.zeros(len(outfit.joint_names), dtype=np.float32)
    outs = [np.zeros((layer.vertex_count, 6), dtype=np.float32) for layer in outfit.layers]
    step = outfit.bind_frame(positions, inputs, outs)

    def drape(pose) -> list[np.ndarray]:
        positions[:] = pose
        step()
        return [out.copy() for out in outs]

    return drape


def frames(rig):
    """Stamp [ns], joint positions (d,), place and quaternion of a root that moves on, and is put elsewhere once."""
    for k, stamp in enumerate(TIMES.tolist()):
        turn = Rotation.from_euler("zyx", (0.05 * k, 0.3 * np.sin(0.2 * k), 0.1)).as_quat().tolist()
        positions = rig.rest + 0.1 * np.sin(0.3 * k + np.arange(len(rig.rest)))
        yield stamp, positions.astype(np.float32), (0.02 * k + 5.0 * (k > 6), 0.1 * np.sin(0.4 * k), 0.9), turn


@pytest.mark.parametrize("sway", [1.0, 0.4])
def test_cloth_moves_as_that_of_a_draper_told_time_and_root(drapers, sway):
    """Bit for bit, with a network and without; garments sway by themselves."""
    outfits, told = [[draper.outfit.twin() for draper in drapers] for _ in range(2)]
    state, motion, alone = state_of(*outfits), RootMotion(), drapers[0].outfit.twin()
    state.frame_input.sway = sways = (sway, 1.0)
    drapes, moved = [bound(state, outfit, row) for row, outfit in enumerate(outfits)], 0.0
    for outfit, amount in zip(told, sways):
        outfit.sway = amount
    for stamp, pose, place, turn in frames(alone.rig):
        down, sample = motion.move(stamp, place, turn)
        state.add_motion(sample, stamp, now_ns=0)
        assert state.take(stamp, 0)
        state.begin_frame(*divmod(stamp, 10**9))
        clouds = [drape(pose)[0] for drape in drapes]
        for cloud, outfit in zip(clouds, told):
            np.testing.assert_array_equal(cloud, *outfit.drape(pose, time=1e-9 * stamp, root=(*place, *turn)))
        moved = max(moved, np.abs(clouds[0] - alone.drape(pose, down)[0])[:, :3].max())
    assert moved > 0.02 * sway, "the network moves nothing"


def test_without_a_root_joints_alone_swing_it(outfit):
    state, told, alone, swung = state_of(outfit), outfit.twin(), outfit.twin(), 0.0
    drape = bound(state, outfit)
    for k, (stamp, pose, *_) in enumerate(frames(outfit.rig)):
        down = np.array([0.6 * (k > 9), 0, -0.8 - 0.2 * (k <= 9)], dtype=np.float32)
        state.add_direction(down, stamp)
        assert not state.take(stamp, 0)
        state.begin_frame(*divmod(stamp, 10**9))
        (cloud,) = drape(pose)
        np.testing.assert_array_equal(cloud, *told.drape(pose, down, time=1e-9 * stamp))
        swung = max(swung, np.abs(cloud - alone.drape(pose, down)[0])[:, :3].max())
    assert swung > 0.01


def test_effective_gravity_swings_cloth_as_that_of_a_draper(outfit):
    """Bit for bit, as it comes from its topic and changes; when it is old, gravity alone counts again."""
    state, told, alone, swung = state_of(outfit), outfit.twin(), outfit.twin(), 0.0
    drape = bound(state, outfit)
    for k, (stamp, pose, *_) in enumerate(frames(outfit.rig)):
        felt = np.array([2.0 * np.sin(k), 1.0, -10.8])
        state.add_motion(EffectiveGravity(felt), stamp, now_ns=0)
        assert state.take(stamp, 0)
        state.begin_frame(*divmod(stamp, 10**9))
        (cloud,) = drape(pose)
        np.testing.assert_array_equal(cloud, *told.drape(pose, effective_gravity=felt, time=1e-9 * stamp))
        swung = max(swung, np.abs(cloud - alone.drape(pose, effective_gravity=felt)[0])[:, :3].max())
    assert swung > 0.01
    assert not state.take(stamp, FRESH + 1)
    np.testing.assert_array_equal(state.frame_input.rows[0, :3], DOWN)


def test_an_acceleration_is_felt_as_much_as_garments_sway(outfit):
    """Where it is known what it would be without: of an IMU, but not from the topic of effective gravity."""
    state, at_rest = state_of(outfit, outfit), STANDARD_GRAVITY * np.array([0.6, 0, -0.8])
    state.frame_input.sway, felt = (1.0, 0.25), at_rest + np.array([4.0, 0.0, 2.0])
    for motion, shares in ((EffectiveGravity(felt, at_rest), (1, 0.25)), (EffectiveGravity(felt), (1, 1))):
        state.add_motion(motion, 0, now_ns=0)
        state.take(0, 0)
        expected = [(at_rest + share * (felt - at_rest)) / STANDARD_GRAVITY for share in shares]
        np.testing.assert_allclose(state.frame_input.rows[:, :3], expected, rtol=1e-6)


def test_without_sway_every_frame_is_draped_by_itself(outfit):
    """Bit for bit, also right after the amount has changed; and without stamps."""
    state, motion, alone = state_of(outfit), RootMotion(), outfit.twin()
    drape = bound(state, outfit)
    for k, (stamp, pose, place, turn) in enumerate(frames(outfit.rig)):
        down, sample = motion.move(stamp, place, turn)
        state.add_motion(sample, stamp, now_ns=0)
        if k in (10, 20):
            state.frame_input.sway = (float(k == 20),)
        state.take(stamp, 0)
        state.begin_frame(*(divmod(stamp, 10**9) if k < 20 else (0, 0)))
        (cloud,), (expected,) = drape(pose), alone.drape(pose, state.frame_input.rows[0, :3])
        assert (cloud == expected).all() == (k >= 10)
        if k != 13:  # a doubled stamp says again what it said
            np.testing.assert_allclose(state.frame_input.rows[0, :3], down, atol=1e-6)


def test_sway_may_change_while_running(drapers):
    """As that of a draper, with a network and without."""
    for draper in drapers:
        told, worn, motion = draper.outfit.twin(), draper.outfit.twin(), RootMotion()
        state = state_of(worn)
        drape = bound(state, worn)
        for k, (stamp, pose, place, turn) in enumerate(frames(told.rig)):
            told.sway = sway = (1.0, 0.3, 0.0)[k // 4 % 3]
            state.frame_input.sway = (sway,)
            state.add_motion(motion.move(stamp, place, turn)[1], stamp, now_ns=0)
            state.take(stamp, 0)
            state.begin_frame(*divmod(stamp, 10**9))
            np.testing.assert_array_equal(drape(pose), told.drape(pose, time=1e-9 * stamp, root=(*place, *turn)))


def test_directions_go_with_joint_states_by_their_stamps(outfit):
    """The last known where none has come; another as of now ends those before; how the root moves counts first."""
    state = RootState(np.array([0.0, 0.0, -3.0]), outfit.frame_input)
    rows = outfit.frame_input.rows
    state.take(5, 0)
    assert rows[0, :3].tolist() == state.direction(5).tolist() == [0, 0, -1]
    state.add_direction(np.float32([1, 0, 0]), 1000)
    state.add_direction(np.float32([0, 1, 0]), 2000)
    state.take(1500, 0)
    assert rows[0, :3].tolist() == [1, 0, 0]
    state.set_direction(np.array([0.0, -7.0, 0.0]))
    state.take(1500, 0)
    assert rows[0, :3].tolist() == [0, -1, 0]
    state.add_motion(EffectiveGravity(np.zeros(3)), 1500, now_ns=0)
    assert state.moves(0) and not state.moves(FRESH + 1)
    assert state.take(1500, 0) and not rows[0, :3].any()
    assert not state.take(1500, FRESH + 1) and rows[0, :3].tolist() == [0, -1, 0]


def test_an_outfit_swings_as_one_told_time_and_root():
    """Bit for bit, one garment by its network, one without any."""
    rng, amounts = np.random.default_rng(4), (0.6, 1.0)
    inner = random_model(rng, garment=tube(radius=0.1), learnt_sway=True)
    outer = random_model(rng, rig=inner.rig, garment=tube(radius=0.4))
    models = [replace(model, name=f"radius {k}") for k, model in enumerate((inner, outer))]
    told = Outfit(models, random_avatar(rng, inner.rig), precision="fp32", hide_covered=False)
    worn, motion = told.twin(), RootMotion()
    state, told.sway = state_of(worn), amounts
    state.frame_input.sway, drape = amounts, bound(state, worn)
    for stamp, pose, place, turn in frames(told.rig):
        state.add_motion(motion.move(stamp, place, turn)[1], stamp, now_ns=0)
        state.take(stamp, 0)
        state.begin_frame(*divmod(stamp, 10**9))
        for cloud, expected in zip(drape(pose), told.drape(pose, time=1e-9 * stamp, root=(*place, *turn))):
            np.testing.assert_array_equal(cloud, expected)


def test_effective_gravity_that_is_reported(drapers):
    """As the garment feels it, wind included, before any joint state comes; there is none while messages say where the
    root is."""
    state, motion = state_of(*(draper.outfit for draper in drapers)), RootMotion()
    state.frame_input.sway = (0.5, 1.0)
    assert state.effective_gravity(1, 0) is None
    for k in range(20):
        state.add_motion(motion.move(k + 1, (0, 0, 0), (0, 0, 0, 1))[1], k + 1, now_ns=0)
    assert state.effective_gravity(1, 0) is None
    for at_rest, sizes in ((None, (-4.905, -4.905)), (np.array([0, 0, -9.81]), (-0.75 * 9.81, -4.905))):
        state.add_motion(EffectiveGravity(np.array([0, 0, -4.905]), at_rest), 30, now_ns=0)
        for garment, size in enumerate(sizes):
            np.testing.assert_allclose(state.effective_gravity(garment, 0), [0, 0, size], rtol=1e-6)
    state.frame_input.wind = (3.0, 0.0, 0.0)
    np.testing.assert_allclose(state.effective_gravity(1, 0), [6, 0, -4.905], rtol=1e-6)
    assert state.effective_gravity(1, FRESH + 1) is None


def test_wind_blows_on_whatever_is_known_of_the_root(outfit):
    """As on a draper; in the world that poses are given in."""
    state, told, motion, alone = state_of(outfit), outfit.twin(), RootMotion(), outfit.twin()
    drape, moved = bound(state, outfit), 0.0
    for k, (stamp, pose, place, turn) in enumerate(frames(outfit.rig)):
        state.frame_input.wind = told.wind = (-5.0, 2.0 * np.sin(k), 0.0)
        state.add_motion(motion.move(stamp, place, turn)[1], stamp, now_ns=0)
        state.take(stamp, 0)
        state.begin_frame(*divmod(stamp, 10**9))
        (cloud,), still = drape(pose), alone.drape(pose, time=1e-9 * stamp, root=(*place, *turn))
        np.testing.assert_array_equal(cloud, *told.drape(pose, time=1e-9 * stamp, root=(*place, *turn)))
        moved = max(moved, np.abs(cloud - still[0])[:, :3].max())
    assert moved > 0.005
