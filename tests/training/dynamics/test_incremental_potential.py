"""The incremental potential: its derivatives, and cloth that falls as the equation of motion says."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp
from random_models import tube

from physkin_core.model.garment_model import Material
from physkin_training.dynamics.incremental_potential import Dynamics, IncrementalHessian, IncrementalPotential
from physkin_training.dynamics.step_solver import StepSolver

CPU = torch.device("cpu")
STEP = 1 / 120
FAR_AWAY = np.array([[50.0, 0, 0], [51, 0, 0], [50, 1, 0]], dtype=np.float32)


class Tube:
    """Two samples of a tube far from a body of one triangle."""

    def __init__(self, dynamics: Dynamics) -> None:
        wp.config.quiet = True
        wp.init()
        self.garment = tube(rings=4, segments=7, radius=0.1, height=0.12)
        self.body = wp.Mesh(
            wp.array(FAR_AWAY, dtype=wp.vec3, device="cpu"), wp.array([0, 1, 2], dtype=wp.int32, device="cpu")
        )
        self.potential = IncrementalPotential(self.garment, Material(), 2, CPU, step=STEP, dynamics=dynamics)
        self.hessian = IncrementalHessian(self.garment, self.potential, 2, CPU)
        self.down, self.offset = torch.tensor([[0.0, 0, -1]] * 2), torch.zeros(2, 3)
        self.rest = torch.tensor(np.stack([self.garment.vertices] * 2), dtype=torch.float32)

    def evaluate(self, x):
        terms, gradient = self.potential.evaluate(x, self.down, self.body, self.offset)
        return sum(values.double() for values in terms.values()), gradient.double()

    def moved(self, seed):
        noise = np.random.default_rng(seed).normal(scale=2e-3, size=self.rest.shape)
        return self.rest + torch.tensor(noise, dtype=torch.float32)


def test_gradient_is_that_of_the_energy():
    scene = Tube(Dynamics(air_drag=40.0, relaxation=0.05))
    x = scene.moved(0)
    scene.potential.begin(scene.moved(1), scene.moved(2))
    _, gradient = scene.evaluate(x)
    way = scene.moved(3) - scene.rest
    h = 0.02
    change = (scene.evaluate(x + h * way)[0] - scene.evaluate(x - h * way)[0]) / (2 * h)
    assert change.numpy() == pytest.approx((gradient * way).sum(dim=(1, 2)).numpy(), rel=2e-3)


def test_second_derivative_is_that_of_the_gradient():
    """Where the strain has not changed yet; else the block leaves out what could be negative."""
    scene = Tube(Dynamics(air_drag=40.0, relaxation=0.5))
    x, way = scene.moved(0), scene.moved(3) - scene.rest
    scene.potential.begin(x, scene.moved(2))
    scene.evaluate(x)
    scene.hessian.assemble(x, scene.body, scene.offset, torch.tensor([True, True]))
    product = torch.zeros_like(x)
    scene.hessian.multiply(way, product)
    h = 0.02
    change = (scene.evaluate(x + h * way)[1] - scene.evaluate(x - h * way)[1]) / (2 * h)
    assert torch.linalg.vector_norm(product - change) < 0.01 * torch.linalg.vector_norm(change)


def test_cloth_falls_through_air():
    drag = 3.0
    scene = Tube(Dynamics(air_drag=drag))
    solver = StepSolver(scene.potential, scene.hessian, torch.ones(scene.rest.shape[1], dtype=torch.bool))
    here, velocity, expected = scene.rest, torch.zeros_like(scene.rest), 0.0
    for _ in range(12):
        scene.potential.begin(here, here + STEP * velocity)
        step = solver.minimise(here, scene.down, scene.body, scene.offset, tolerance=1e-6, iterations=3, products=60)
        velocity, here = (step.vertices - here) / STEP, step.vertices
        expected = (expected - STEP * 9.81) / (1 + STEP * drag)
    assert velocity[..., 2].mean().item() == pytest.approx(expected, rel=1e-3)
    assert velocity[..., :2].abs().max() < 1e-3, "cloth at rest in itself keeps its shape while it falls"


def test_what_is_held_stays():
    scene = Tube(Dynamics())
    free = torch.arange(scene.rest.shape[1]) >= 7
    solver = StepSolver(scene.potential, scene.hessian, free)
    scene.potential.begin(scene.rest, scene.rest)
    step = solver.minimise(scene.rest, scene.down, scene.body, scene.offset, tolerance=1e-6, iterations=2, products=40)
    assert torch.equal(step.vertices[:, ~free], scene.rest[:, ~free])
    assert (step.vertices - scene.rest)[:, free].abs().max() > 1e-6


@pytest.mark.parametrize(("name", "value"), [("air_drag", -1.0), ("relaxation", float("nan"))])
def test_bad_dynamics_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        Dynamics(**{name: value})


def test_a_step_takes_time():
    with pytest.raises(ValueError, match="step must be positive"):
        IncrementalPotential(Tube(Dynamics()).garment, Material(), 1, CPU, step=0.0, dynamics=Dynamics())
