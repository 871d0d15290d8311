"""Second derivatives of the physics losses: against finite differences, and positive where promised."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp
from random_models import tube

from physkin_core.model.garment_model import Material
from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.physics.rest_data import RestData

CPU = torch.device("cpu")
SAMPLES = 2
FLOOR = np.array([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0]], dtype=np.float32)


class Scene:
    """A crumpled tube about the origin, 12 cm high, and a floor at height `floor`."""

    def __init__(
        self, *, floor: float, bending: float = 1e-3, youngs_modulus: float = 60.0, scale: float = 1.0
    ) -> None:
        wp.config.quiet = True
        wp.init()
        rng = np.random.default_rng(3)
        self.garment = tube(rings=4, segments=7, radius=0.1, height=0.12)
        material = Material(bending=bending, youngs_modulus=youngs_modulus, contact_stiffness=1e5)
        self.x = torch.tensor(
            scale * self.garment.vertices + rng.normal(scale=2e-3, size=(SAMPLES, *self.garment.vertices.shape)),
            dtype=torch.float32,
        )
        floor = wp.array(FLOOR + [0, 0, floor], dtype=wp.vec3, device="cpu")
        self.body = wp.Mesh(floor, wp.array([0, 1, 2, 0, 2, 3], dtype=wp.int32, device="cpu"))
        self.offset = torch.zeros(SAMPLES, 3)
        self.down = torch.tensor([[0.0, 0, -1]] * SAMPLES)
        shapes = np.stack([self.garment.vertices, self.garment.vertices * [1.2, 0.9, 1.1]])
        rest = RestData(self.garment, material, CPU, shapes=shapes)
        self.losses = PhysicsLosses(self.garment, material, SAMPLES, CPU, rest=rest)
        self.hessian = EnergyHessian(self.garment, self.losses, SAMPLES, CPU)

    def gradient(self, x):
        return self.losses.evaluate(x, self.down, self.body, self.offset)[1].double()

    def matrix(self, *, exact: bool, sample: int = 0) -> np.ndarray:
        """(3 n, 3 n) at x, column by column."""
        self.gradient(self.x)
        self.hessian.assemble(self.x, self.body, self.offset, torch.full((SAMPLES,), exact))
        columns = []
        for column in range(self.x[0].numel()):
            unit, product = torch.zeros_like(self.x), torch.zeros_like(self.x)
            unit.view(SAMPLES, -1)[:, column] = 1.0
            self.hessian.multiply(unit, product)
            columns.append(product[sample].reshape(-1).numpy().astype(float))
        return np.stack(columns, axis=1)


@pytest.mark.parametrize("bending, youngs_modulus", [(1e-9, 60.0), (1e-3, 1e-3), (1e-3, 60.0)])
@pytest.mark.parametrize("floor", [-9.0, -0.057])
@pytest.mark.parametrize("rows", [(0, 0), (1, 0)])
def test_exact_blocks_match_finite_differences_of_the_gradient(bending, youngs_modulus, floor, rows):
    scene = Scene(floor=floor, bending=bending, youngs_modulus=youngs_modulus)
    scene.losses.rest_row.copy_(torch.tensor(rows))
    generator = torch.Generator().manual_seed(0)
    scene.gradient(scene.x)
    assert (scene.losses.element_energies["collision"].sum() > 0) == (floor > -1)
    scene.hessian.assemble(scene.x, scene.body, scene.offset, torch.tensor([True, True]))
    for _ in range(3):
        direction = torch.randn(scene.x.shape, generator=generator)
        product = torch.zeros_like(direction)
        scene.hessian.multiply(direction, product)
        h = 2e-5
        difference = (scene.gradient(scene.x + h * direction) - scene.gradient(scene.x - h * direction)) / (2 * h)
        near = scene.losses.signed_distance.sub(scene.losses.material.contact_offset).abs() > 4 * h
        assert near.float().mean() > 0.9  # a vertex just touching has no second derivative
        error = (product - difference)[near].norm() / difference[near].norm()
        assert error < 5e-3


@pytest.mark.parametrize("scale, compressed", [(0.9, True), (1.1, False)])
def test_positive_blocks(scale, compressed):
    """Compressed cloth can buckle: its exact second derivative curves down somewhere, the other one nowhere."""
    scene = Scene(floor=-0.057, scale=scale)
    exact, positive = scene.matrix(exact=True), scene.matrix(exact=False)
    largest = np.abs(positive).max()
    for matrix in (exact, positive):
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-5 * largest)
    assert np.linalg.eigvalsh((positive + positive.T) / 2).min() > -1e-5 * largest
    if compressed:
        assert np.linalg.eigvalsh((exact + exact.T) / 2).min() < -1e-3 * largest


def test_the_two_agree_at_the_rest_shape():
    scene = Scene(floor=-9.0)
    scene.x = torch.tensor(scene.garment.vertices, dtype=torch.float32).repeat(SAMPLES, 1, 1)
    exact, positive = scene.matrix(exact=True), scene.matrix(exact=False)
    np.testing.assert_allclose(exact, positive, atol=1e-4 * np.abs(positive).max())


def test_the_preconditioner_inverts_the_diagonal_blocks_with_what_was_added():
    scene = Scene(floor=-0.057)
    matrix = scene.matrix(exact=False, sample=1)
    n = len(scene.garment.vertices)
    extra = torch.randn(SAMPLES, n, 3, 3, generator=torch.Generator().manual_seed(1))
    extra = extra @ extra.transpose(2, 3)
    scene.hessian.add_to_diagonal(extra, torch.tensor([0.0, 50.0]))
    vector = torch.randn(SAMPLES, n, 3, generator=torch.Generator().manual_seed(2))
    result = scene.hessian.precondition(vector)[1].numpy()
    for v in range(n):
        block = matrix[3 * v : 3 * v + 3, 3 * v : 3 * v + 3] + extra[1, v].numpy()
        block = block + 50.0 * scene.garment.vertex_areas[v] * np.eye(3)
        np.testing.assert_allclose(block @ result[v], vector[1, v].numpy(), atol=2e-3)


def test_only_active_samples_are_worked_on():
    scene = Scene(floor=-0.057)
    scene.gradient(scene.x)
    scene.hessian.active.copy_(torch.tensor([False, True]))
    scene.hessian.assemble(scene.x, scene.body, scene.offset, torch.tensor([True, True]))
    product = torch.full_like(scene.x, 7.0)
    scene.hessian.multiply(scene.x, product)
    assert (product[0] == 7.0).all() and not (product[1] == 7.0).any()
