"""The curriculum's steps, the box of joint positions and the directions of gravity."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from random_models import random_rig

from physkin_training.sampling.pose_sampling import PoseSampler, pose_range

RIG = random_rig(np.random.default_rng(0), bones=4, dofs=6)
COUNT = 20000


def draw(share=1.0, *, upright=0.5, count=COUNT):
    torch.manual_seed(1)
    sampler = PoseSampler(RIG, torch.device("cpu"), upright=upright)
    positions, gravity = sampler.sample(count, share)
    return positions.double().numpy(), gravity.double().numpy()


def tilt_of(gravity):
    return np.arctan2(np.hypot(gravity[:, 0], gravity[:, 1]), -gravity[:, 2])


# --- Curriculum ---


@pytest.mark.parametrize("growth", [0.25, 0.5, 1.0])
def test_range_grows_in_steps_of_ten_percent(growth):
    """10 % at the start, nine equal steps, all of the limits at `growth` of the run and ever after."""
    progress = np.linspace(0, 1, 9001)
    ranges = np.array([pose_range(p, growth) for p in progress])
    values, first = np.unique(ranges.round(9), return_index=True)
    np.testing.assert_allclose(values, np.arange(1, 11) / 10)
    np.testing.assert_allclose(progress[first], growth * np.arange(10) / 9, atol=2e-4)
    assert (np.diff(ranges) >= 0).all()
    assert pose_range(growth, growth) == pose_range(1.0, growth) == pose_range(0.0, 0.0) == 1.0


# --- Joint positions ---


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_joint_positions_fill_the_box_around_rest(share):
    """Uniform from rest - share (rest - lower) to rest + share (upper - rest), joint by joint, independent."""
    positions, _ = draw(share)
    low, high = RIG.rest + share * (RIG.lower - RIG.rest), RIG.rest + share * (RIG.upper - RIG.rest)
    assert positions.shape == (COUNT, 6)
    within = (positions - low) / (high - low)
    assert within.min() > -1e-5 and within.max() < 1 + 1e-5
    assert within.min(axis=0).max() < 2e-3 and within.max(axis=0).min() > 1 - 2e-3
    for joint in range(6):
        counts, _ = np.histogram(within[:, joint], bins=10, range=(0, 1))
        assert np.abs(counts - COUNT / 10).max() < 6 * math.sqrt(COUNT / 10)
    correlation = np.corrcoef(within.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.04


def test_range_may_be_a_tensor_that_changes():
    """A step recorded as a CUDA graph reads its range from memory."""
    sampler = PoseSampler(RIG, torch.device("cpu"), upright=0.5)
    share = torch.zeros(())
    spreads = []
    for value in (0.1, 1.0):
        share.fill_(value)
        spreads.append(sampler.sample(2000, share)[0].std(dim=0))
    torch.testing.assert_close(spreads[1] / spreads[0], torch.full((6,), 10.0), rtol=0.1, atol=0)


# --- Gravity ---


@pytest.mark.parametrize("upright", [0.0, 0.3, 0.5, 1.0])
def test_share_of_upright_roots(upright):
    """Exactly upright, or leaning; unit vectors all."""
    _, gravity = draw(upright=upright)
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), 1, atol=1e-6)
    share = (np.abs(gravity - [0, 0, -1]).max(axis=1) < 1e-7).mean()
    assert share == pytest.approx(upright, abs=4 * math.sqrt(0.25 / COUNT) if 0 < upright < 1 else 1e-3)


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_leaning_roots_lean_uniformly_up_to_the_largest_tilt(share):
    """Tilt uniform from none to 110 degrees times the range; any way with equal chance."""
    _, gravity = draw(share, upright=0.0)
    tilt = np.degrees(tilt_of(gravity))
    assert tilt.max() < 110 * share + 1e-3
    counts, _ = np.histogram(tilt, bins=10, range=(0, 110 * share))
    assert np.abs(counts - COUNT / 10).max() < 6 * math.sqrt(COUNT / 10)
    azimuth = np.arctan2(gravity[:, 1], gravity[:, 0])
    counts, _ = np.histogram(azimuth, bins=8, range=(-math.pi, math.pi))
    assert np.abs(counts - COUNT / 8).max() < 6 * math.sqrt(COUNT / 8)


def test_a_generator_of_its_own_leaves_the_others_alone():
    """The same samples whatever was drawn before, and nothing taken from the device's own generator."""
    sampler = PoseSampler(RIG, torch.device("cpu"), upright=0.5)
    drawn = []
    for seed in (0, 1):
        state = torch.manual_seed(seed).get_state()
        drawn.append(sampler.sample(50, 1.0, generator=torch.Generator().manual_seed(3)))
        assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(first, again) for first, again in zip(*drawn))
