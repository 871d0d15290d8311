"""Our solver against newton's cloth, on a case small enough for a test: a band of cloth come to rest on a ball."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
import warp as wp
from random_models import tube

from physkin_core import Garment
from physkin_core.model.garment_model import Material
from physkin_core.quality import edge_strain
from physkin_studies.crosscheck import Drape, newton_drape, surface_distance, table
from physkin_training.physics.full_space_solver import FullSpaceSolver
from physkin_training.physics.physics_losses import PhysicsLosses

CPU = torch.device("cpu")


def test_table_has_a_column_for_every_term():
    """Terms that the losses gain, such as the band's, must not shift the total under another heading."""
    band = tube(rings=2, segments=8, radius=0.1, height=0.02)
    garment = Garment(band.vertices, band.faces)
    energies = {name: torch.tensor([value]) for name, value in (("stretch", 0.5), ("bend", 0.25), ("band", 1.0))}
    drape = Drape(1.01 * band.vertices, energies, (2.0, 1.0))
    lines = table(garment, {"a": drape, "b": drape}).split("\n")
    head, _, *rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    assert {len(row) for row in (head, *rows)} == {len(head)}
    assert [row[0] for row in rows] == ["a", "b"]
    values = dict(zip(head, rows[0]))
    assert values["edge %"] == "1.000" and values["CPU seconds"] == "1.0"
    assert values["band J"] == "1.0000" and values["total J"] == "1.7500"


@pytest.mark.slow
def test_a_band_on_a_ball():
    pytest.importorskip("newton", reason="compares with newton: pip install newton")
    band = tube(rings=5, segments=24, radius=0.1, height=0.06)
    garment = Garment(band.vertices + [0, 0, 0.1], band.faces)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.12)
    vertices, faces = np.asarray(ball.vertices, dtype=np.float32), np.asarray(ball.faces, dtype=np.int32)
    material = Material(density=1.0, bending=1e-4, contact_stiffness=1e6)
    theirs = newton_drape(garment, material, garment.vertices, vertices, faces, np.array([0.0, 0, -1]))
    assert theirs.speed < 5e-3, "newton's cloth has not come to rest"
    body = wp.Mesh(wp.array(vertices, dtype=wp.vec3, device="cpu"), wp.array(faces.reshape(-1), device="cpu"))
    solver = FullSpaceSolver(garment, PhysicsLosses(garment, material, 1, CPU), 1, CPU)
    start = torch.tensor(garment.vertices, dtype=torch.float32)[None]
    ours = solver.minimise(start, torch.tensor([[0.0, 0, -1]]), body, torch.zeros(1, 3), tolerance=1e-2)
    assert ours.converged.all()
    drape = ours.vertices[0].double().numpy()
    # At a strain of 3 % newton's neo-Hookean cloth is softer than ours by about three times that.
    assert edge_strain(garment, drape) == pytest.approx(edge_strain(garment, theirs.vertices), rel=0.12)
    assert surface_distance(garment, drape, theirs.vertices)[1] < 4e-3
