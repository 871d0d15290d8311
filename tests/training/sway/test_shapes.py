"""Principal shapes: what is in their span is kept, what they leave is what they say."""

from __future__ import annotations

import pytest
import torch

from physkin_training.sway.shapes import principal_shapes

SIZE = 24


@pytest.fixture
def spread():
    """Offsets (400, 24) of five directions about a mean; metrics; half of the numbers are held."""
    generator = torch.Generator().manual_seed(0)

    def metric():
        factor = torch.randn(SIZE, SIZE, generator=generator)
        return factor @ factor.T / SIZE + 0.1 * torch.eye(SIZE)

    inertia, cost = metric(), metric()
    inertia[12:], inertia[:, 12:] = 0, 0
    directions = torch.randn(5, SIZE, generator=generator) * torch.tensor([3.0, 2, 1, 0.5, 0.3])[:, None]
    offsets = torch.randn(SIZE, generator=generator) + torch.randn(400, 5, generator=generator) @ directions
    offsets[:, 12:] = 0
    return offsets, inertia, cost


def test_what_shapes_span_comes_back(spread):
    offsets, inertia, cost = spread
    shapes, moved, missed = principal_shapes(offsets.split(150), inertia, cost, 99, 2.0)
    assert len(shapes.directions) == 5, "there are no more"
    coefficients = shapes.coefficients(offsets)
    torch.testing.assert_close(shapes.offsets(coefficients), offsets, atol=2e-3, rtol=1e-3)
    assert shapes.offsets(coefficients)[:, 12:].abs().max() < 1e-4
    assert missed < 1e-2 * moved
    away = offsets - offsets.mean(dim=0)
    weighed = 1e6 * torch.einsum("ni,ij,nj->n", away, inertia, away) / 2.0
    torch.testing.assert_close(shapes.millimetres(coefficients), weighed, rtol=2e-2, atol=1.0)
    assert moved == pytest.approx(float(weighed.mean().sqrt()), rel=1e-3)


def test_few_shapes_leave_what_they_say(spread):
    offsets, inertia, cost = spread
    shapes, moved, missed = principal_shapes([offsets], inertia, cost, 2, 2.0)
    left = shapes.offsets(shapes.coefficients(offsets)) - offsets
    weighed = 1e3 * (torch.einsum("ni,ij,nj->n", left, inertia, left).mean() / 2.0).sqrt()
    assert missed == pytest.approx(float(weighed), rel=1e-2)
    assert 0 < missed < 0.6 * moved


def test_cloth_that_does_not_move_has_none(spread):
    offsets, inertia, cost = spread
    with pytest.raises(ValueError, match="nothing is to be learnt of 2 frames"):
        principal_shapes([torch.zeros(2, SIZE)], inertia, cost, 2, 2.0)
