"""Cloth that goes through itself is led out of itself, whichever side it came from, and no other cloth is moved."""

from __future__ import annotations

import numpy as np
import torch

from physkin_core.model.garment import Garment
from physkin_training.contact.surface_queries import piercing_edges
from physkin_training.train.untangling import EVERY, Untangling

EDGE = 0.01


def folded(through: float) -> Garment:
    """A strip 8 cm wide, folded over; a dent in its upper half goes through the lower one by `through` [m]."""
    along, across = np.meshgrid(np.arange(25), np.arange(9), indexing="ij")
    s, y = EDGE * (along.ravel() - 12), EDGE * (across.ravel() - 4)
    dent = (0.006 + through) * np.exp(-((s - 0.06) ** 2 + y**2) / (2 * 0.02**2))
    vertices = np.stack([-np.abs(s), y, np.where(s < 0, 0.0, 0.006 - dent)], axis=1)
    index = np.arange(along.size).reshape(along.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    return Garment(vertices, faces)


def crossed(vertices: np.ndarray, garment: Garment) -> int:
    return int(piercing_edges(vertices, garment.faces, garment.edges).sum())


def descended(garment: Garment, steps: int) -> np.ndarray:
    """(EVERY + 1, n, 3) after steps of a tenth of a millimetre; samples 0 and EVERY are looked at."""
    offset = 3.0 * torch.arange(EVERY + 1)[:, None] * torch.eye(3)[0]
    untangling = Untangling(garment, offset)
    untangling.share.fill_(1.0)
    weight = torch.ones(len(offset))
    weight[EVERY] = 0.0
    drapes = torch.tensor(garment.vertices, dtype=torch.float32).repeat(len(offset), 1, 1)
    for _ in range(steps):
        drapes.requires_grad_(True)
        (gradient,) = torch.autograd.grad(untangling(drapes, weight), drapes)
        drapes = (drapes - 1e-4 * gradient / gradient.abs().max().clamp_min(1e-9)).detach()
    return drapes.numpy()


def test_a_fold_that_goes_through_itself_comes_out_of_itself():
    """The force says nothing of other samples, and nothing where a sample's weight is 0."""
    garment = folded(through=0.004)
    before = crossed(garment.vertices, garment)
    drapes = descended(garment, 150)
    assert before >= 5
    assert crossed(drapes[0], garment) == 0
    assert np.array_equal(drapes[1:], np.tile(garment.vertices.astype(np.float32), (EVERY, 1, 1)))


def test_a_fold_that_does_not_is_left_alone():
    garment = folded(through=-0.003)
    assert crossed(garment.vertices, garment) == 0
    assert np.array_equal(descended(garment, 1)[0], garment.vertices.astype(np.float32))


def test_samples_skinned_for_engines_are_looked_at_too():
    """The last eighth of each body's samples; a body has 8 on a CPU and 16 on a GPU."""
    for samples in (8, 16):
        looked_at = np.arange(0, 384, EVERY) % samples
        assert np.isin(np.arange(samples - samples // 8, samples), looked_at).all()
