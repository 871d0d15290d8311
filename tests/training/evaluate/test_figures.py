"""The torch figures are those of `physkin_core.quality`, in whatever batches."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the [training] extra")
pytest.importorskip("warp", reason="needs the [training] extra")

from random_models import tube  # noqa: E402

from physkin_core import quality  # noqa: E402
from physkin_core.model.garment_model import Material  # noqa: E402
from physkin_training.evaluate.figures import Figures  # noqa: E402
from physkin_training.physics.physics_losses import Energies  # noqa: E402
from physkin_training.physics.rest_data import RestData  # noqa: E402

CPU = torch.device("cpu")
GARMENT = tube()
TERMS = ("stretch", "bend", "collision", "gravity")


def drapes(count, *, seed=4):
    """Crumpled tubes (count, n, 3), energies by term (count,), distances (count, n) and inside flags (count, n)."""
    rng = np.random.default_rng(seed)
    n = len(GARMENT.vertices)
    vertices = GARMENT.vertices + 0.003 * rng.normal(size=(count, n, 3))
    arrays = (vertices, rng.uniform(size=(count, 4)), rng.normal(scale=0.01, size=(count, n)))
    return [torch.as_tensor(a, dtype=torch.float32) for a in arrays] + [torch.as_tensor(rng.random((count, n)) < 0.2)]


def count_in(figures, batch, pick, **options):
    vertices, terms, distance, inside = (a[pick] for a in batch)
    band = torch.zeros(len(distance))
    energies = Energies(*terms.T, band=band, signed_distance=distance, at_worn_part=worn_parts(distance))
    figures.add(vertices, energies, inside, **options)


def worn_parts(distance):
    """Flags (B, n) that depend on the vertex alone: every third one."""
    return (torch.arange(distance.shape[1]) % 3 == 0).expand_as(distance)


@pytest.mark.parametrize("sizes", [(6,), (1, 2, 3)])
def test_figures_are_those_of_quality(sizes):
    """Means over samples, the deepest depth of all, in any batches."""
    batch = vertices, terms, distance, inside = drapes(6)
    figures = Figures(GARMENT, CPU)
    for pick in torch.arange(6).split(list(sizes)):
        count_in(figures, batch, pick)
    row, contact = figures.result(), quality.contact_figures(distance.numpy())
    assert row["edge_strain_percent"] == pytest.approx(quality.edge_strain(GARMENT, vertices.numpy()).mean(), rel=1e-4)
    assert row["area_strain_percent"] == pytest.approx(quality.area_strain(GARMENT, vertices.numpy()).mean(), rel=1e-4)
    for name, value in contact.items():
        assert row[name] == pytest.approx(value, rel=1e-5), name
    inside_worn = (distance < 0) & worn_parts(distance)
    assert row["inside_worn_percent"] == pytest.approx(100 * inside_worn.double().mean().item(), rel=1e-5)
    assert row["inside_by_vertex_percent"] == pytest.approx(100 * inside.double().mean().item(), rel=1e-5)
    for name, column in zip(TERMS, terms.T):
        assert row[f"{name}_j"] == pytest.approx(column.mean().item()), name
    assert row["energy_j"] == pytest.approx(row["stretch_j"] + row["bend_j"] + row["collision_j"])
    assert row["pairs"] == 6 and "jitter_mm" not in row


def test_strain_is_against_each_drapes_own_rest_shape():
    """Two rest shapes, drapes in any order of them; without rows the first one."""
    batch = vertices, *_ = drapes(4)
    shapes = [GARMENT, GARMENT.reshaped(GARMENT.vertices * [1.1, 0.9, 1.2])]
    rest = RestData(GARMENT, Material(), CPU, shapes=np.stack([shape.vertices for shape in shapes]))
    figures, plain = Figures(GARMENT, CPU, rest=rest), Figures(GARMENT, CPU, rest=rest)
    rows = [1, 0, 0, 1]
    count_in(figures, batch, slice(None), rest_row=torch.tensor(rows, dtype=torch.int32))
    count_in(plain, batch, slice(None))
    for name, strain in (("edge", quality.edge_strain), ("area", quality.area_strain)):
        expected = np.mean([strain(shapes[row], x.numpy()) for row, x in zip(rows, vertices, strict=True)])
        assert figures.result()[f"{name}_strain_percent"] == pytest.approx(expected, rel=1e-4)
        expected = strain(GARMENT, vertices.numpy()).mean()
        assert plain.result()[f"{name}_strain_percent"] == pytest.approx(expected, rel=1e-4)


def test_depth_percentile_is_over_each_drapes_deepest():
    """Of 1,001 drapes the second deepest; the deepest vertex of each, however many are inside."""
    batch = drapes(1001)
    figures = Figures(GARMENT, CPU)
    count_in(figures, batch, slice(None))
    depths = np.sort(-1000 * batch[2].numpy().min(axis=1))
    row = figures.result()
    assert row["max_depth_p999_mm"] == pytest.approx(depths[-2], rel=1e-5)
    assert row["max_depth_mm"] == pytest.approx(depths[-1], rel=1e-5) and depths[-1] > 1.001 * depths[-2]


def test_only_the_first_count_drapes_count():
    batch = drapes(6)
    whole, part = Figures(GARMENT, CPU), Figures(GARMENT, CPU)
    count_in(part, batch, slice(None), count=4, takes=torch.zeros(6, dtype=torch.int64))
    count_in(whole, batch, slice(4), takes=torch.zeros(4, dtype=torch.int64))
    assert part.result() == whole.result()


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


def test_snaps_are_those_of_quality_within_takes():
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
    expected = [quality.snaps(frames[part]) for part in (slice(0, 5), slice(7, 12))]
    assert expected == [pytest.approx(2 / 3), 0]
    assert figures.result()["snaps_percent"] == pytest.approx(100 * 2 / 6)


def test_figures_include_others():
    batch = drapes(9)
    takes = torch.zeros(9, dtype=torch.int64)
    parts = []
    for pick in (slice(0, 4), slice(4, 9)):
        part = Figures(GARMENT, CPU)
        count_in(part, batch, pick, takes=takes[pick])
        parts.append(part)
    whole, together = Figures(GARMENT, CPU), Figures(GARMENT, CPU)
    takes[4:] = 1
    count_in(whole, batch, slice(None), takes=takes)
    for part in parts:
        together.include(part)
    assert together.result() == pytest.approx(whole.result())
