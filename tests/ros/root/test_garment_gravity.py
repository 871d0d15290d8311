"""What garments are told, draped beside drapers and outfits that are told the same times and roots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from physkin_ros.root.garment_gravity import GarmentGravity
from random_models import random_avatar, random_model, tube
from scipy.spatial.transform import Rotation

from physkin_core import Draper, Outfit
from physkin_ros.root.gravity import FRESH, Felt
from physkin_ros.root.root_motion import RootMotion

DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)
MILLISECOND = 1_000_000
TIMES = np.cumsum([1000, *[16] * 12, 0, 16, 16, 50, 7, 400, *[16] * 6, -5000, *[33] * 8]) * MILLISECOND
"""Stamps [ns]: frames at several rates, a doubled one, a gap, a clock that goes back."""


@pytest.fixture(scope="module")
def drapers():
    """One with a sway network and one that a pendulum moves, of one rig and body."""
    rng = np.random.default_rng(3)
    learnt = random_model(rng, learnt_sway=True)
    other = random_model(rng, rig=learnt.rig)
    avatar = random_avatar(rng, learnt.rig)
    return [Draper(replace(model, name=name), avatar, precision="fp32")
            for name, model in (("learnt", learnt), ("other", other))]  # fmt: skip


def another(draper: Draper) -> Draper:
    """The same, with frames of its own."""
    return Draper(draper.model, draper.avatar, precision="fp32", binding=draper.bound)


def stepped(told: GarmentGravity, draper: Draper, row: int = 0):
    """A frame of a draper of its own, bound to a garment's row, and what it reads and writes."""
    own = another(draper)
    positions, out = np.zeros(len(own.joint_names), dtype=np.float32), np.zeros((own.vertex_count, 6), np.float32)
    return own.bind_step(positions, told.felt[row], out), positions, out


def frames(rig):
    """Stamp [ns], joint positions (d,), place and quaternion of a root that moves on, and is put elsewhere once."""
    for k, stamp in enumerate(TIMES.tolist()):
        turn = Rotation.from_euler("zyx", (0.05 * k, 0.3 * np.sin(0.2 * k), 0.1)).as_quat().tolist()
        positions = rig.rest + 0.1 * np.sin(0.3 * k + np.arange(len(rig.rest)))
        yield stamp, positions.astype(np.float32), (0.02 * k + 5.0 * (k > 6), 0.1 * np.sin(0.4 * k), 0.9), turn


@pytest.mark.parametrize("sway", [1.0, 0.4])
def test_cloth_moves_as_that_of_a_draper_told_time_and_root(drapers, sway):
    """By the network, or by the pendulum; garments sway by themselves."""
    told, motion, learnt = GarmentGravity(DOWN, [sway, 1.0]), RootMotion([sway, 1.0]), np.array([True, False])
    steps = [stepped(told, draper, row) for row, draper in enumerate(drapers)]
    alone, moved = another(drapers[0]), 0.0
    for draper, amount in zip(drapers, (sway, 1.0)):
        draper.sway = amount
        draper.reset()
    for stamp, pose, place, turn in frames(drapers[0].model.rig):
        down, felt = motion.move(stamp, place, turn)
        told.add_felt(felt, stamp, now_ns=0)
        assert told.take_felt(stamp, 0, learnt)
        told.begin_frame(*divmod(stamp, 10**9))
        for draper, (step, positions, out) in zip(drapers, steps):
            positions[:] = pose
            step()
            expected = draper.drape(pose, time=1e-9 * stamp, root=(*place, *turn))
            np.testing.assert_allclose(out, expected, atol=2e-5)
        moved = max(moved, np.abs(steps[0][2] - alone.drape(pose, down))[:, :3].max())
    assert moved > 0.02 * sway, "the network moves nothing"


def test_without_a_root_joints_alone_swing_it(drapers):
    told, draper = GarmentGravity(DOWN, [1.0]), drapers[0]
    step, positions, out = stepped(told, draper)
    alone, draper.sway, swung = another(draper), 1.0, 0.0
    draper.reset()
    for k, (stamp, pose, *_) in enumerate(frames(draper.model.rig)):
        down = np.array([0.6 * (k > 9), 0, -0.8 - 0.2 * (k <= 9)], dtype=np.float32)
        told.add_direction(down, stamp)
        assert not told.take_felt(stamp, 0, np.array([True]))
        told.take_by_stamp(stamp)
        told.begin_frame(*divmod(stamp, 10**9))
        positions[:] = pose
        step()
        np.testing.assert_allclose(out, draper.drape(pose, down, time=1e-9 * stamp), atol=2e-5)
        swung = max(swung, np.abs(out - alone.drape(pose, down))[:, :3].max())
    assert swung > 0.01


@pytest.mark.parametrize("rows", [(4,), (1, 4)])
def test_effective_gravity_alone_moves_no_network(drapers, rows):
    """As it comes from its topic, or from an IMU; when it is old, joints swing the cloth again."""
    told, draper = GarmentGravity(DOWN, [1.0]), drapers[0]
    felt = np.array([0.2, 0.1, -1.1, 0.0], dtype=np.float32)
    step, positions, out = stepped(told, draper)
    draper.sway = 1.0
    draper.reset()
    for stamp, pose, *_ in frames(draper.model.rig):
        told.add_felt(Felt(felt.reshape(rows)), stamp, now_ns=0)
        assert told.take_felt(stamp, 0, np.array([True]))
        told.begin_frame(*divmod(stamp, 10**9))
        assert told.felt[0, 5] == 0
        positions[:] = pose
        step()
        expected = draper.drape(pose, effective_gravity=9.81 * felt[:3], time=1e-9 * stamp)
        np.testing.assert_allclose(out, expected, atol=2e-5)
    assert not told.take_felt(stamp, FRESH + 1, np.array([True]))
    told.take_by_stamp(stamp)
    told.begin_frame(*divmod(stamp, 10**9))
    assert told.felt[0, 5] == 1


def test_without_sway_every_frame_is_draped_by_itself(drapers):
    """Bit for bit, also right after the amount has changed; and without stamps."""
    told, motion, draper = GarmentGravity(DOWN, [1.0]), RootMotion([1.0]), drapers[0]
    (step, positions, out), alone = stepped(told, draper), another(draper)
    for k, (stamp, pose, place, turn) in enumerate(frames(draper.model.rig)):
        if k == 10:
            told.set_sway([0.0])  # what has come tells of the sway before
        if k == 20:
            told.set_sway([1.0])
        _, felt = motion.move(stamp, place, turn)
        told.add_felt(felt, stamp, now_ns=0)
        told.take_felt(stamp, 0, np.array([True]))
        told.begin_frame(*(divmod(stamp, 10**9) if k < 20 else (0, 0)))
        positions[:] = pose
        step()
        assert (out == alone.drape(pose, told.gravity[0, :3])).all() == (k >= 10)


def test_an_outfit_swings_as_one_told_time_and_root():
    """One garment by its network, one by the pendulum."""
    rng, amounts = np.random.default_rng(4), (0.6, 1.0)
    inner = random_model(rng, garment=tube(radius=0.1), learnt_sway=True)
    outer = random_model(rng, rig=inner.rig, garment=tube(radius=0.4))
    models = [replace(model, name=f"radius {k}") for k, model in enumerate((inner, outer))]
    outfit = Outfit(models, random_avatar(rng, inner.rig), precision="fp32", hide=False)
    outfit.sway, worn = amounts, outfit.twin()
    told, motion = GarmentGravity(DOWN, amounts), RootMotion(amounts)
    positions = np.zeros(len(outfit.joint_names), dtype=np.float32)
    outs = [np.zeros((count, 6), dtype=np.float32) for count in outfit.vertex_counts]
    step = worn.bind_step(positions, told.felt, outs)
    for stamp, pose, place, turn in frames(models[0].rig):
        told.add_felt(motion.move(stamp, place, turn)[1], stamp, now_ns=0)
        told.take_felt(stamp, 0, np.array([True, False]))
        told.begin_frame(*divmod(stamp, 10**9))
        positions[:] = pose
        step()
        for out, expected in zip(outs, outfit.drape(pose, time=1e-9 * stamp, root=(*place, *turn))):
            np.testing.assert_allclose(out[:, :3], expected[:, :3], atol=1e-4)


def test_effective_gravity_that_is_reported():
    """Of garments that a sway network moves by the root's rates there is none."""
    told, motion = GarmentGravity(DOWN, [1.0, 1.0]), RootMotion([1.0, 1.0])
    assert told.effective_gravity(0, 0, learnt=False) is None
    told.add_felt(motion.move(1000, (0, 0, 0), (0, 0, 0, 1))[1], 1000, now_ns=0)
    np.testing.assert_allclose(told.effective_gravity(1, 0, learnt=False), [0, 0, -9.81])
    assert told.effective_gravity(0, 0, learnt=True) is None
    told.add_felt(Felt(np.float32([0, 0, -0.5, 0])), 2000, now_ns=0)
    np.testing.assert_allclose(told.effective_gravity(0, 0, learnt=True), [0, 0, -4.905])
