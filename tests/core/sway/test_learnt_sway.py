"""Garments with a sway network: oscillators of the reference, and drapes that are told time and root."""

from types import SimpleNamespace

import numpy as np
import pytest
from random_models import random_sway_network
from reference.frame_input import FrameInput
from reference.sway_network import SwayNetwork

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
