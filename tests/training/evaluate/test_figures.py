"""The torch figures are those of `physkin_core.quality`, in whatever batches."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from random_models import tube

from physkin_core import quality
from physkin_training.evaluate.figures import SNAP, Figures
from physkin_training.physics.physics_losses import Energies

CPU = torch.device("cpu")
GARMENT = tube()
TERMS = ("stretch", "bend", "collision", "gravity")


def drapes(count, *, seed=4):
    """Crumpled tubes (count, n, 3), energies by term (count,) and distances (count, n)."""
    rng = np.random.default_rng(seed)
    n = len(GARMENT.vertices)
    vertices = GARMENT.vertices + 0.003 * rng.normal(size=(count, n, 3))
    arrays = (vertices, rng.uniform(size=(count, 5)), rng.normal(scale=0.01, size=(count, n)))
    return [torch.as_tensor(a, dtype=torch.float32) for a in arrays]


def count_in(figures, batch, pick, **options):
    vertices, terms, distance = (a[pick] for a in batch)
    held = dict.fromkeys(("band", "threads"), torch.zeros(len(distance)))
    energies = Energies(*terms.T, **held, signed_distance=distance, at_worn_part=worn_parts(distance))
    figures.add(vertices, energies, **options)


def worn_parts(distance):
    """Flags (B, n) that depend on the vertex alone: every third one."""
    return (torch.arange(distance.shape[1]) % 3 == 0).expand_as(distance)


def test_depth_percentile_is_over_each_drapes_deepest():
    """Of 1,001 drapes the second deepest; the deepest vertex of each, however many are inside."""
    batch = drapes(1001)
    figures = Figures(GARMENT, CPU)
    count_in(figures, batch, slice(None))
    depths = np.sort(-1000 * batch[2].numpy().min(axis=1))
    row = figures.result()
    assert row["max_depth_p999_mm"] == pytest.approx(depths[-2], rel=1e-5)
    assert row["max_depth_mm"] == pytest.approx(depths[-1], rel=1e-5) and depths[-1] > 1.001 * depths[-2]
    inside_worn = (batch[2] < 0) & worn_parts(batch[2])
    assert row["inside_worn_percent"] == pytest.approx(100 * inside_worn.double().mean().item(), rel=1e-5)


@pytest.mark.parametrize("sizes", [(12,), (1,) * 12, (5, 5, 2)])
def test_jitter_is_that_of_quality_within_takes(sizes):
    """Takes of 5, 2 and 5 frames: the second has no second difference, and none spans two takes."""
    batch = drapes(12)
    batch[0] += torch.linspace(0, 3, 12)[:, None, None] ** 2
    takes = torch.tensor([0] * 5 + [1] * 2 + [2] * 5)
    figures = Figures(GARMENT, CPU)
    for pick in torch.arange(12).split(list(sizes)):
        count_in(figures, batch, pick, takes=takes[pick])
    expected = np.mean([quality.jitter(batch[0].numpy()[part]) for part in (slice(0, 5), slice(7, 12))])
    assert figures.result()["jitter_mm"] == pytest.approx(1000 * expected, rel=1e-4)


def snaps(frames):
    """Share of the frames (T, n, 3) of one take, the first and last left out, in which cloth snaps."""
    second = np.linalg.norm(np.diff(frames, n=2, axis=0), axis=-1)
    return float((second.max(axis=1) - np.quantile(second, 0.9, axis=1) > SNAP).mean())


def test_a_snap_is_of_few_vertices_not_of_the_body():
    """All that moves at once, however suddenly, is motion; one vertex in fifty that jumps is a snap, in both frames
    whose second difference holds the jump."""
    frames = np.zeros((10, 50, 3))
    frames[5:] += 0.3
    assert snaps(frames) == 0
    frames[5:, 7] += 0.03
    assert snaps(frames) == pytest.approx(2 / 8)
    frames[5:, 7] -= 0.01
    assert snaps(frames) == 0


def test_snaps_are_counted_within_takes():
    """A vertex that jumps for good in one frame of each take; a jump from one take to the next is none."""
    batch = drapes(12)
    batch[0][:] = batch[0][:1].clone()
    batch[0][3:5, 7] += 0.08
    batch[0][5:] += 1.0
    batch[0][9:, 7] += 0.01
    takes = torch.tensor([0] * 5 + [1] * 2 + [2] * 5)
    figures, frames = Figures(GARMENT, CPU), batch[0].numpy()
    for pick in torch.arange(12).split(5):
        count_in(figures, batch, pick, takes=takes[pick])
    expected = [snaps(frames[part]) for part in (slice(0, 5), slice(7, 12))]
    assert expected == [pytest.approx(2 / 3), 0]
    assert figures.result()["snaps_percent"] == pytest.approx(100 * 2 / 6)
    twice = Figures(GARMENT, CPU)
    for _ in range(2):
        twice.include(figures)
    assert twice.result() == pytest.approx(figures.result() | {"pairs": 24}, rel=0.01), "all that the other counted"
