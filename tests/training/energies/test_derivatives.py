"""Every energy by itself: its gradient against differences of its value, its second derivative against differences of
its gradient, and positive where that is promised."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from training.crumpled_tube import LINEAR_BEYOND, CrumpledTube

NAMES = ("stretch", "bend", "collision", "gravity", "band", "strain_rate", "inertia", "drag", "threads")
H = 0.02
WAYS = [3, 4, 5]
LED_BACK = {"worn": False, "leads_back": True, "floor": -0.04}


def test_none_is_forgotten():
    """Self-contact has tests of its own."""
    assert {each.name for each in CrumpledTube().potential.energies} == {*NAMES, "self_contact"}


@pytest.mark.parametrize(
    "name, options",
    [*((name, {}) for name in NAMES), ("collision", {"linear_beyond": LINEAR_BEYOND}), ("collision", LED_BACK)],
)
def test_derivatives(name, options):
    tube = CrumpledTube(name, **options)
    energy, gradient = tube.evaluate(tube.x)
    assert energy.abs().min() > 0, "it must act on both samples"
    kinks = torch.zeros(tube.x.shape[:2], dtype=torch.bool)
    if name == "collision":  # no second derivative where contact begins, or begins to be linear
        depth = tube.potential.material.contact_offset - tube.potential.collision.signed_distance
        kinks = (depth.abs() < 1e-4) | ((depth - LINEAR_BEYOND).abs() < 1e-4)
        linear = depth > tube.potential.collision.linear_beyond
        assert bool(options) == (linear.any() or options is LED_BACK) and kinks.float().mean() < 0.1
    for seed in WAYS:
        way = H * (tube.crumpled(seed) - tube.rest)
        tube.assemble(exact=True)
        product = tube.product(way)
        (above, forward), (below, backward) = tube.evaluate(tube.x + way), tube.evaluate(tube.x - way)
        work = (gradient * way).sum(dim=(1, 2))
        torch.testing.assert_close(work, (above - below) / 2, rtol=5e-3, atol=float(2e-7 * energy.abs().max()))
        change = (forward - backward) / 2
        error = torch.linalg.vector_norm((product - change)[~kinks])
        assert error < 5e-3 * torch.linalg.vector_norm(change[~kinks]) + 1e-6 * torch.linalg.vector_norm(gradient)


def test_derivatives_of_cloth_that_yields_under_compression():
    """They jump where a strain changes its sign, which a small step seldom does."""
    tube = CrumpledTube("stretch")
    whole, _ = tube.evaluate(tube.x)
    tube.potential.stretch.compressed = 0.2
    energy, gradient = (each.clone() for each in tube.evaluate(tube.x))
    assert (energy < 0.95 * whole).all() and (energy > 0.2 * whole).all()
    tube.assemble(exact=True)
    for seed in WAYS:
        way = 0.1 * H * (tube.crumpled(seed) - tube.rest)
        product = tube.product(way)
        (above, forward), (below, backward) = tube.evaluate(tube.x + way), tube.evaluate(tube.x - way)
        torch.testing.assert_close((gradient * way).sum(dim=(1, 2)), (above - below) / 2, rtol=5e-3, atol=1e-6)
        change = (forward - backward) / 2
        assert torch.linalg.vector_norm(product - change) < 0.03 * torch.linalg.vector_norm(change)


@pytest.mark.parametrize("scale, compressed", [(0.9, True), (1.1, False)])
@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("gravity", "inertia", "drag")])
def test_positive_blocks(name, scale, compressed):
    """Compressed cloth can buckle: its exact second derivative curves down somewhere, the other one nowhere."""
    tube = CrumpledTube(name, scale=scale)
    exact, positive = tube.matrix(exact=True), tube.matrix(exact=False)
    largest = np.abs(positive).max()
    for matrix in (exact, positive):
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-5 * largest)
    assert np.linalg.eigvalsh((positive + positive.T) / 2).min() > -1e-5 * largest
    if name == "stretch" and compressed:
        assert np.linalg.eigvalsh((exact + exact.T) / 2).min() < -1e-3 * largest


def test_a_band_that_holds_alike_in_every_direction():
    tube = CrumpledTube("band")
    tube.potential.band.isotropic = True
    block = tube.matrix(exact=True)[:3, :3]
    area = tube.potential.rest.vertex_area[1, 0].item()
    np.testing.assert_allclose(block, 2e5 * area * np.eye(3), rtol=1e-5)


def test_contact_foresees_what_a_step_within_it_brings():
    tube = CrumpledTube("collision", linear_beyond=LINEAR_BEYOND)
    tube.evaluate(tube.x)
    foreseen = tube.potential.collision.forecast()
    step = H * (tube.crumpled(3) - tube.rest)
    before = tube.potential.collision.values.clone()
    tube.evaluate(tube.x + step)
    change = tube.potential.collision.values - before
    assert change.abs().max() > 1e-7
    torch.testing.assert_close(foreseen(step), tube.potential.collision.values, rtol=0, atol=2e-3 * change.abs().max())
