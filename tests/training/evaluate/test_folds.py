"""Figures of folds on a triangle and on a strip, with the answers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from physkin_core import Garment
from physkin_training.evaluate.folds import FoldFigures, averaged_with_neighbours

CPU = torch.device("cpu")
TRIANGLE = Garment(np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2]], dtype=np.int32))
STRIP = Garment(
    np.array([[x, y, 0.0] for x in (0.0, 0.1, 0.2, 0.3) for y in (0.0, 0.1)]),
    np.array([face for k in (0, 2, 4) for face in ([k, k + 2, k + 1], [k + 1, k + 2, k + 3])], dtype=np.int32),
)


def at_heights(*heights):
    """Triangles (B, 3, 3) [m] with their corners there."""
    vertices = torch.as_tensor(TRIANGLE.vertices.copy(), dtype=torch.float32).repeat(len(heights), 1, 1)
    vertices[:, :, 2] = torch.tensor(heights)
    return vertices


def squared_heights(vertices):
    """Stands for bending energy."""
    return vertices[..., 2].square().sum(dim=1)


def figures_of(garment, drapes, minima, *, sizes, **options):
    """Over batches of those sizes, each filled up with a drape that does not count."""
    figures = FoldFigures(garment, CPU)
    for drape, other in zip(drapes.split(sizes), minima.split(sizes)):
        filled = torch.cat([drape, 7 * drape[:1]]), torch.cat([other, 2 * other[:1]])
        figures.add(*filled, squared_heights, count=len(drape), **options)
    return figures.result()


def test_averages_with_neighbours():
    """All corners of a triangle meet in its middle; a strip's end has two neighbours or three."""
    together = averaged_with_neighbours(at_heights([0.0, 0.0, 0.3]), torch.tensor(TRIANGLE.edges.copy()))
    expected = torch.tensor([0.1 / 3, 0.1 / 3, 0.1]).expand(1, 3, 3)
    torch.testing.assert_close(together, expected)
    strip = torch.as_tensor(STRIP.vertices.copy(), dtype=torch.float32)[None]
    moved = averaged_with_neighbours(strip, torch.tensor(STRIP.edges.copy()))[0]
    torch.testing.assert_close(moved[0], torch.tensor([0.1 / 3, 0.1 / 3, 0.0]))
    torch.testing.assert_close(moved[1], torch.tensor([0.2 / 4, 0.2 / 4, 0.0]))


@pytest.mark.parametrize("sizes", [(2,), (1, 1)])
def test_energy_and_noise_are_ratios_of_sums(sizes):
    """Averaging takes all of the first drape's energy and none of the second's; of the minima's 6 / 9, and none."""
    drapes, minima = at_heights([0.01, -0.01, 0.0], [0.02, 0.02, 0.02]), at_heights([0.02, 0.02, -0.01], [0.01] * 3)
    result = figures_of(TRIANGLE, drapes, minima, sizes=sizes)
    assert result["fold_energy_ratio"] == pytest.approx((2 + 12) / (9 + 3))
    assert result["fold_noise_ratio"] == pytest.approx(2 / (9 - 3))


@pytest.mark.parametrize("sizes", [(2,), (1, 1)])
def test_normals_are_compared_near_the_minimum(sizes):
    """A strip turned by 3 degrees, of which half is within 10 mm; and one turned by 1 degree, all of it within."""
    flat = torch.as_tensor(STRIP.vertices.copy(), dtype=torch.float32).expand(2, -1, -1)
    turned = flat.clone()
    for k, degrees in enumerate((3.0, 1.0)):
        turned[k, :, 0] = np.cos(np.radians(degrees)) * flat[k, :, 0]
        turned[k, :, 2] = np.sin(np.radians(degrees)) * flat[k, :, 0]
    result = figures_of(STRIP, turned, flat, sizes=sizes)
    assert result["normal_error_degrees"] == pytest.approx((4 * 3 + 8 * 1) / 12, abs=1e-3)

    straight_on = torch.tensor([0.0, 0, 1]).expand(2, len(STRIP.vertices), 3)
    assert figures_of(STRIP, turned, flat, sizes=(2,), normals=straight_on)["normal_error_degrees"] == 0


def test_nothing_to_compare_with():
    """Flat minima bend nowhere, and a drape farther away than 10 mm has no normal to compare."""
    flat = at_heights([0.0] * 3)
    assert figures_of(TRIANGLE, at_heights([0.02] * 3), flat, sizes=(1,)) == {}
