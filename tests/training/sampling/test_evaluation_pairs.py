"""Uniform pairs are the training's own poses; motion pairs are the clip's frames, body by body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from physkin_core import load_body_model, load_motion
from physkin_training.sampling.evaluation_pairs import motion_pairs, uniform_pairs
from physkin_training.sampling.pose_sampling import PoseSampler

RIG = load_body_model().rig


@pytest.mark.parametrize("upright", [True, False])
def test_poses_are_drawn_as_in_training(upright):
    sampler = PoseSampler(RIG, torch.device("cpu"), upright=float(upright))
    positions, gravity = sampler.sample(6, 1.0, generator=torch.Generator().manual_seed(7))
    pairs = uniform_pairs(RIG, bodies=2, poses=3, seed=7, upright=upright)
    assert torch.equal(pairs.positions, positions) and torch.equal(pairs.gravity, gravity)
    assert pairs.body.tolist() == [0, 1] * 3


@pytest.mark.parametrize("count, expected", [(1, [0]), (3, [0, 2, 5]), (9, [0, 1, 2, 3, 4, 5])])
def test_a_subset_is_spread_over_all_pairs(count, expected):
    pairs = uniform_pairs(RIG, bodies=2, poses=3, seed=0, upright=True)
    part = pairs.spread(count)
    assert torch.equal(part.positions, pairs.positions[expected]) and torch.equal(part.body, pairs.body[expected])
    assert torch.equal(part.gravity, pairs.gravity[expected])


def test_motion_pairs_are_frames_in_order_body_by_body():
    """Columns are matched by name; gravity turns with the root."""
    motion = load_motion("cartwheel")
    turned = replace(motion, joint_names=motion.joint_names[::-1], positions=motion.positions[:, ::-1])
    pairs = motion_pairs(turned, RIG, bodies=3)
    frames = motion.frame_count
    assert len(pairs) == 3 * frames and pairs.body.tolist() == [0] * frames + [1] * frames + [2] * frames
    for start in range(0, len(pairs), frames):
        np.testing.assert_array_equal(pairs.positions[start : start + frames].numpy(), motion.positions_for(RIG))
        np.testing.assert_array_equal(pairs.gravity[start : start + frames].numpy(), motion.gravity)
