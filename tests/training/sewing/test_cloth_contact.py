"""Cloth that feels itself: it is held off itself, never comes through itself, and is led out of itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_training.contact.surface_queries import piercing_edges
from physkin_training.energies.energy import Drapes, view
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.sewing import cloth_contact
from physkin_training.sewing.cloth_contact import ClothContact

STEP = 0.02
SIDE = 9


def sheets(seed: int = 0, uneven: float = 0.001) -> tuple[Garment, np.ndarray]:
    """Two square sheets of 16 cm, one 12 mm above the other and turned a little, and the panel of each vertex."""
    x, y = (axis.ravel() for axis in np.meshgrid(STEP * np.arange(SIDE), STEP * np.arange(SIDE)))
    corner = (SIDE * np.arange(SIDE - 1)[:, None] + np.arange(SIDE - 1)).reshape(-1)
    faces = np.concatenate([corner[:, None] + [0, 1, SIDE + 1], corner[:, None] + [0, SIDE + 1, SIDE]])
    low, (c, s) = np.column_stack([x, y, 0 * x]), (np.cos(0.1), np.sin(0.1))
    high = low @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) + [0.003, 0.004, 0.012]
    vertices = np.concatenate([low, high]) + np.random.default_rng(seed).normal(0, uneven, (2 * len(low), 3))
    return Garment(vertices, np.concatenate([faces, faces + len(low)])), np.repeat([0, 1], len(low))


def contact_of(garment: Garment, panel: np.ndarray) -> ClothContact:
    losses = PhysicsLosses(garment, Material(), 1, torch.device("cpu"))
    return ClothContact(losses.cloth, np.arange(len(panel)), panel, garment.vertices[:, :2])


def evaluated(contact: ClothContact, vertices: torch.Tensor) -> tuple[float, torch.Tensor]:
    """Energy [J] and gradient (1, n, 3)."""
    drapes, gradient = Drapes(), torch.zeros_like(vertices)
    drapes.x, drapes.gradient = view(vertices), view(gradient)
    contact.evaluate(drapes)
    return float(contact.values.sum(dtype=torch.float64)), gradient


@pytest.mark.parametrize("seed", range(4))
def test_whatever_moves_stays_apart(seed):
    """Random steps of up to 4 cm, many times as far as the sheets are apart: no edge goes through a face, ever."""
    garment, panel = sheets(seed)
    contact, random = contact_of(garment, panel), torch.Generator().manual_seed(seed)
    here = torch.tensor(garment.vertices, dtype=torch.float32)[None]
    moved = 0.0
    for _ in range(12):
        contact.look(here)
        wish = here + 0.04 * (2 * torch.rand(here.shape, generator=random) - 1)
        there = contact.kept_apart(wish)
        assert not piercing_edges(there[0].numpy(), garment.faces, garment.edges).any()
        moved, here = moved + float((there - here).norm(dim=2).mean()), there
    assert moved > 0.02, "and yet it moves"


def test_without_planes_it_would_go_through():
    garment, panel = sheets()
    contact = contact_of(garment, panel)
    here = torch.tensor(garment.vertices, dtype=torch.float32)[None]
    down = torch.zeros_like(here)
    down[0, panel == 1, 2] = -0.0125
    contact.look(here)
    assert piercing_edges((here + down)[0].numpy(), garment.faces, garment.edges).any()
    kept = contact.kept_apart(here + down)
    assert not piercing_edges(kept[0].numpy(), garment.faces, garment.edges).any()
    assert not contact.is_held_back(kept)
    assert contact.is_held_back(contact.kept_apart(here + 0.02)), "as far as it may go"


def test_gradient_and_bound():
    """Of the energy where sheets are 2 mm apart; the blocks on the diagonal bound how it bends."""
    garment, panel = sheets(uneven=0.0002)
    near = garment.vertices - np.outer(panel, [0, 0, 0.010])
    contact, x = contact_of(garment, panel), torch.tensor(near, dtype=torch.float32)[None]
    contact.look(x)
    energy, gradient = evaluated(contact, x)
    assert energy > 0
    blocks = contact.state[0].clone()
    random = torch.Generator().manual_seed(1)
    for _ in range(5):
        step = 2e-5 * torch.randn(x.shape, generator=random)
        ahead, _ = evaluated(contact, x + step)
        behind, _ = evaluated(contact, x - step)
        slope = float((gradient * step).sum())
        assert (ahead - behind) / 2 == pytest.approx(slope, rel=0.02, abs=1e-9)
        bend = float(torch.einsum("nx,nxy,ny->", step[0], blocks[0], step[0]))
        assert ahead + behind - 2 * energy <= bend + 1e-9
    far, _ = evaluated(contact, x + torch.tensor(np.outer(panel, [0, 0, 0.01]), dtype=torch.float32))
    assert far == 0


def test_what_goes_through_is_led_out():
    """The upper sheet cuts 1.5 cm into the edge of the lower one; plain descent of the energy takes it out."""
    garment, panel = sheets()
    tilted = garment.vertices.copy()
    upper = panel == 1
    tilted[upper] = tilted[upper][:, [2, 1, 0]] * [1, 1, -1] + [0.145, 0.002, 0.105]
    contact, x = contact_of(garment, panel), torch.tensor(tilted, dtype=torch.float32)[None]
    count = [int(piercing_edges(tilted, garment.faces, garment.edges).sum())]
    for _ in range(60):
        contact.look(x)
        _, gradient = evaluated(contact, x)
        rigid = torch.stack([gradient[0, panel == side].mean(dim=0) for side in (0, 1)])[panel]
        x = x - 0.0015 * rigid / rigid.norm(dim=1).max().clamp_min(1e-12)
        count.append(int(piercing_edges(x[0].numpy(), garment.faces, garment.edges).sum()))
        if count[-1] == 0:
            break
    assert count[0] > 3 and count[-1] == 0


def test_panels_that_begin_in_each_other():
    """They do not feel each other until they are told to."""
    garment, panel = sheets()
    crossed = garment.vertices - np.outer(panel, [0, 0, 0.012])
    contact, x = contact_of(garment, panel), torch.tensor(crossed, dtype=torch.float32)[None]
    contact.look(x)
    contact.let_through()
    contact.look(x)
    assert evaluated(contact, x)[0] == 0
    contact.let_none_through()
    contact.look(x)
    assert evaluated(contact, x)[1].abs().max() > 0


def test_many_pairs_are_no_overflow(monkeypatch):
    monkeypatch.setattr(cloth_contact, "PAIRS", 1)
    garment, panel = sheets()
    contact = contact_of(garment, panel)
    contact.look(torch.tensor(garment.vertices, dtype=torch.float32)[None])
    assert contact._count == len(panel)
