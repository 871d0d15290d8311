"""Motions of walkers: within limits, smooth, one a seed, as often mirrored."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core.avatar.body_model import load_body_model
from physkin_core.rig.rig import Rig
from physkin_training.sway import motions as motions_module
from physkin_training.sway.motions import MotionPool, mirrored_motion

RIG = load_body_model().rig


@pytest.fixture(scope="module")
def pool():
    return MotionPool(RIG)


def test_motions_are_what_a_body_can_do(pool):
    motions = pool.drawn(range(60), 180, seed=0)
    assert (motions.positions >= RIG.lower - 1e-6).all() and (motions.positions <= RIG.upper + 1e-6).all()
    unit = np.broadcast_to(np.eye(3), motions.turn.shape)
    np.testing.assert_allclose(motions.turn @ motions.turn.swapaxes(-1, -2), unit, atol=1e-5)
    assert (np.linalg.det(motions.turn) > 0).all()
    assert np.abs(np.diff(motions.positions, axis=1)).max() < 30 / 60  # [rad] a frame
    assert np.linalg.norm(np.diff(motions.place, axis=1), axis=2).max() < 8 / 60  # [m] a frame
    assert np.ptp(motions.place, axis=1).max(axis=1).mean() > 0.3, "bodies go about"
    pull = np.einsum("btij,btj->bti", motions.turn, motions.gravity) + [0, 0, 1]  # of the wind, in the world
    windy = np.abs(pull).max(axis=(1, 2)) > 0.01
    assert 0.15 < windy.mean() < 0.55 and np.abs(pull[~windy]).max() < 1e-5
    assert 0.1 < np.linalg.norm(pull, axis=2).max() < 2.8, "training knows no more"
    assert np.abs(np.diff(pull, axis=1)).max() < 0.3, "it does not jump"


def test_who_sits_down_keeps_feet_where_they_stand(pool, monkeypatch):
    for name, share in (("FROM_CLIPS", 0.0), ("THROUGH_POSES", 0.0), ("SITTING", 1.0)):
        monkeypatch.setattr(motions_module, name, share)
    motions = pool.drawn(range(8), 240, seed=0)
    thighs = [RIG.joint_names.index(f"upperleg01.{side}_y") for side in "LR"]
    seated = (motions.positions[..., thighs] < np.radians(-60)).all(axis=2)
    assert seated.any(axis=1).all() and not seated[:, 0].any()
    assert (np.ptp(motions.place[..., 2], axis=1) > 0.25).all()
    ankles = [RIG.bone_index(f"foot.{side}") for side in "LR"]
    for walker in range(8):
        bones = RIG.bone_transforms(motions.positions[walker].astype(np.float64))[:, ankles]
        here = np.einsum("tbij,bj->tbi", bones[..., :3], RIG.heads[ankles]) + bones[..., 3]
        there = np.einsum("tij,tbj->tbi", motions.turn[walker], here) + motions.place[walker][:, None]
        assert np.ptp(there, axis=0).max() < 0.15, "as knees go apart feet slide a little"


def test_a_walker_is_one_by_seed_and_number(pool):
    both = pool.drawn(range(2), 30, seed=3)
    np.testing.assert_array_equal(pool.drawn(range(1, 2), 30, seed=3).positions[0], both.positions[1])
    assert np.abs(both.positions[0] - both.positions[1]).max() > 0.01
    assert np.abs(pool.drawn(range(1), 30, seed=4).positions[0] - both.positions[0]).max() > 0.01


def test_mirrored_bones_are_on_the_other_side_of_the_world(pool):
    motions = pool.drawn(range(7, 8), 3, seed=0)
    motion = (motions.positions[0].astype(np.float64), motions.place[0], motions.turn[0])
    positions, place, turn = mirrored_motion(RIG, *motion)

    def heads(pose, at, turned):
        bones = RIG.bone_transforms(pose)
        return (np.einsum("bij,bj->bi", bones[..., :3], RIG.heads) + bones[..., 3]) @ turned.T + at

    here, there = heads(*(a[2] for a in motion)), heads(positions[2], place[2], turn[2])
    for index, name in enumerate(RIG.bone_names):
        other = name.replace(".L", ".\0").replace(".R", ".L").replace(".\0", ".R")
        np.testing.assert_allclose(there[RIG.bone_index(other)], here[index] * [1, -1, 1], atol=0.01)


def test_a_rig_of_other_joints_is_refused():
    from dataclasses import replace

    other = Rig(RIG.bone_names, RIG.parents, RIG.heads, RIG.tails, (replace(RIG.dofs[0], name="knee"), *RIG.dofs[1:]))
    with pytest.raises(ValueError, match="everyday poses are of the default rig"):
        MotionPool(other)
