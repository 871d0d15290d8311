"""What is added to skinning frame by frame, as an offset and few morph targets."""

import numpy as np
import pytest

from physkin_core.export.morph_targets import ENOUGH, MOST_TARGETS, in_few_targets, unskinned

RNG = np.random.default_rng(3)
VERTICES, FRAMES = 40, 50


def whole(added):
    """The morph targets of what is added, (T, v, 3), what an engine adds to vertices that are not offset, and what is
    left to add."""
    morphs, offset, left = in_few_targets(added)
    found, lacking = np.zeros_like(added), np.zeros_like(added)
    found[:, morphs.moved] = offset + np.einsum("tk,kui->tui", morphs.weights, morphs.targets)
    lacking[:, morphs.moved] = left
    return morphs, offset, found, lacking


def test_cloth_that_skinning_squeezes_flat_is_not_thrown_far():
    matrices = np.zeros((1, 3, 4))
    matrices[0, :2, :2] = np.eye(2)
    added = unskinned(np.zeros((1, 3)), matrices, np.array([[0.01, 0.0, 0.02]]))
    np.testing.assert_allclose(added, [[0.01, 0.0, 0.0]], atol=1e-4)


def test_few_ways_of_moving_are_held_exactly():
    """Of three there are three targets, with weights from 0 to 1; vertices that never move are not in them."""
    ways = RNG.normal(size=(3, VERTICES, 3)) * (np.arange(VERTICES) > 9)[:, None]
    added = np.einsum("tk,kvi->tvi", 0.1 * RNG.normal(size=(FRAMES, 3)), ways) + 0.005 * ways[0]
    morphs, offset, found, lacking = whole(added)
    assert list(morphs.moved) == list(range(10, VERTICES)) and len(morphs.targets) == 3
    np.testing.assert_allclose([morphs.weights.min(axis=0), morphs.weights.max(axis=0)], [[0] * 3, [1] * 3], atol=1e-9)
    resting = offset + np.einsum("k,kui->ui", morphs.resting, morphs.targets)
    np.testing.assert_allclose(resting, added.mean(axis=0)[10:], atol=1e-9)
    np.testing.assert_allclose(found, added, atol=1e-9)
    assert np.abs(lacking).max() < 1e-9


@pytest.mark.parametrize("fading, most", [(0.8, MOST_TARGETS - 1), (1.0, MOST_TARGETS)])
def test_of_many_ways_as_many_are_held_as_are_needed(fading, most):
    """The most important ones, until all vertices are close, or there are many; what lacks is told."""
    sizes = 0.02 * fading ** np.arange(FRAMES)
    ways = np.einsum("tk,k,kvi->tvi", RNG.normal(size=(FRAMES, FRAMES)), sizes, RNG.normal(size=(FRAMES, VERTICES, 3)))
    morphs, _, found, lacking = whole(ways)
    assert 1 < len(morphs.targets) <= most
    np.testing.assert_allclose(lacking, ways - found, atol=1e-12)
    farthest = np.linalg.norm(lacking, axis=2).max()
    assert farthest < ENOUGH if most < MOST_TARGETS else len(morphs.targets) == MOST_TARGETS


@pytest.mark.parametrize("frames", [1, 4])
def test_cloth_that_nothing_moves_has_no_targets(frames):
    morphs, _, lacking = in_few_targets(np.zeros((frames, VERTICES, 3)))
    assert morphs.targets.shape == (0, 0, 3) and morphs.weights.shape == (frames, 0)
    assert lacking.shape == (frames, 0, 3)


def test_a_still_picture_is_an_offset_alone():
    added = RNG.normal(size=(1, VERTICES, 3))
    morphs, _, found, _ = whole(added)
    assert len(morphs.targets) == 0
    np.testing.assert_allclose(found, added)
