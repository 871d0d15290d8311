"""Steps of implicit Euler: cloth that falls as the equation of motion says."""

from __future__ import annotations

import pytest
import torch
from training.crumpled_tube import STEP, CrumpledTube

from physkin_training.dynamics.step_solver import StepSolver
from physkin_training.energies.motion import Dynamics
from physkin_training.physics.energy_hessian import EnergyHessian


def uncrumpled(drag: float) -> CrumpledTube:
    """At rest, in its own rest shape, with nothing near that it could touch, and not tied by a band or threads."""
    tube = CrumpledTube(floor=-9.0, rows=[0, 0], dynamics=Dynamics(air_drag=drag))
    tube.potential.energies = [each for each in tube.potential.energies if each.name not in ("band", "threads")]
    tube.hessian = EnergyHessian(tube.potential)
    return tube


def solved(tube: CrumpledTube, start: torch.Tensor, free: torch.Tensor):
    solver = StepSolver(tube.hessian, free)
    return solver.minimise(start, tube.down, tube.body, tube.offset, tolerance=1e-6, iterations=3, products=60)


def test_cloth_falls_through_air():
    drag = 3.0
    tube = uncrumpled(drag)
    here, velocity, expected = tube.rest, torch.zeros_like(tube.rest), 0.0
    for _ in range(12):
        tube.potential.begin(here, here + STEP * velocity)
        step = solved(tube, here, torch.ones(here.shape[1], dtype=torch.bool))
        velocity, here = (step.vertices - here) / STEP, step.vertices
        expected = (expected - STEP * 9.81) / (1 + STEP * drag)
    assert velocity[..., 2].mean().item() == pytest.approx(expected, rel=1e-3)
    assert velocity[..., :2].abs().max() < 1e-3, "cloth at rest in itself keeps its shape while it falls"


def test_what_is_held_stays():
    tube = uncrumpled(2.0)
    free = torch.arange(tube.rest.shape[1]) >= 7
    tube.potential.begin(tube.rest, tube.rest)
    step = solved(tube, tube.rest, free)
    assert torch.equal(step.vertices[:, ~free], tube.rest[:, ~free])
    assert (step.vertices - tube.rest)[:, free].abs().max() > 1e-6


def test_resistance_is_what_inertia_and_drag_add_to_the_gradient():
    with_motion = CrumpledTube(dynamics=Dynamics(air_drag=40.0, relaxation=0.0))
    x = with_motion.x
    _, gradient = with_motion.evaluate(x)
    resistance = with_motion.potential.time_step.resistance(x).double()
    with_motion.potential.begin(x, x)
    _, at_rest = with_motion.evaluate(x)
    assert resistance.abs().max() > 1e-3
    torch.testing.assert_close(gradient - at_rest, resistance, rtol=1e-4, atol=1e-4 * float(resistance.abs().max()))


@pytest.mark.parametrize(("name", "value"), [("air_drag", -1.0), ("relaxation", float("nan"))])
def test_bad_dynamics_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        Dynamics(**{name: value})


def test_a_step_takes_time():
    with pytest.raises(ValueError, match="step must be positive"):
        CrumpledTube(step=0.0)
