"""Uniform pairs are the training's own poses; motion pairs are the clip's frames, body by body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the [training] extra")

from physkin_core import load_body_model, load_motion  # noqa: E402
from physkin_training.sampling.evaluation_pairs import LARGEST_TILT, motion_pairs, uniform_pairs  # noqa: E402
from physkin_training.sampling.pose_sampling import PoseSampler  # noqa: E402

RIG = load_body_model().rig


def test_poses_are_uniform_over_the_limits():
    pairs = uniform_pairs(RIG, bodies=2, poses=32, seed=0, upright=True)
    within = (pairs.positions.numpy() - RIG.lower) / (RIG.upper - RIG.lower)
    assert within.min() >= -1e-5 and within.max() <= 1 + 1e-5
    assert np.abs(within.mean(axis=0) - 0.5).max() < 0.2 and within.std() == pytest.approx(12**-0.5, abs=0.01)
    np.testing.assert_allclose(pairs.gravity.numpy(), np.tile([0, 0, -1], (64, 1)), atol=1e-7)
    assert pairs.body.tolist() == [0, 1] * 32
    tilted = uniform_pairs(RIG, bodies=2, poses=32, seed=0, upright=False)
    assert torch.equal(tilted.positions, pairs.positions)
    tilt = np.degrees(np.arccos(-tilted.gravity.numpy()[:, 2]))
    assert tilt.max() < 110.1 and np.quantile(tilt, 0.9) > 70


def test_poses_are_drawn_as_in_training():
    sampler = PoseSampler(RIG, torch.device("cpu"), upright=0.0, largest_tilt=LARGEST_TILT)
    positions, gravity = sampler.sample(6, 1.0, generator=torch.Generator().manual_seed(7))
    pairs = uniform_pairs(RIG, bodies=2, poses=3, seed=7, upright=False)
    assert torch.equal(pairs.positions, positions) and torch.equal(pairs.gravity, gravity)


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
