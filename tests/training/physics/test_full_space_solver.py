"""The full-space solver: known equilibria, the oracle's minimum, creases of a body, and honesty about convergence."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp
from random_models import tube
from scipy.optimize import minimize

from physkin_core import Garment, load_body_model
from physkin_core.model.garment_model import Material
from physkin_training.physics.full_space_solver import FullSpaceSolver
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies
from training import physics_oracle as oracle

CPU = torch.device("cpu")
FAR_AWAY = np.array([[50.0, 0, 0], [51, 0, 0], [50, 1, 0]])
FLOOR = np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]])


@pytest.fixture(autouse=True, scope="module")
def quiet():
    wp.config.quiet = True
    wp.init()


def mesh(vertices, faces) -> wp.Mesh:
    points = wp.array(np.asarray(vertices, dtype=np.float32), dtype=wp.vec3, device="cpu")
    return wp.Mesh(points, wp.array(np.asarray(faces, dtype=np.int32).reshape(-1), device="cpu"))


def solve(garment, material, start, body, *, held=None, **options):
    """Minimise from start (B, n, 3) with gravity along -Z and a body without offset."""
    start = torch.as_tensor(np.asarray(start), dtype=torch.float32)
    samples = len(start)
    losses = PhysicsLosses(garment, material, samples, CPU)
    solver = FullSpaceSolver(losses, held=held)
    down = torch.tensor([[0.0, 0, -1]] * samples)
    return solver.minimise(start, down, body, torch.zeros(samples, 3), **options)


def sheet(side: int, size: float) -> Garment:
    """A square of side * side vertices in the plane Z = 0."""
    grid = np.linspace(-size / 2, size / 2, side)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1, 1)
    faces = np.concatenate([corner + [0, side, side + 1], corner + [0, side + 1, 1]])
    return Garment(np.stack([x.ravel(), y.ravel(), np.zeros(side**2)], axis=1), faces)


@pytest.mark.parametrize("density", [2.0, 20.0])
def test_a_triangle_hanging_from_two_corners(density):
    """Held at two corners, pulled down by its own weight at the third. With height h stretched to lambda h, stress is
    along the pull only as far as the free corner feels it: E / (1 - nu^2) lambda (lambda^2 - 1) / 2 = rho g h / 3."""
    height = 0.3
    garment = Garment(np.array([[-0.2, 0, 0], [0.2, 0, 0], [0, 0, -height]]), np.array([[0, 1, 2]]))
    material = Material(density=density, youngs_modulus=60.0)
    stiffness = material.youngs_modulus / (1 - material.poisson_ratio**2)
    roots = np.roots([1, 0, -1, -2 * density * 9.81 * height / 3 / stiffness])
    (stretch,) = (root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 1)
    start = np.repeat(garment.vertices[None], 2, axis=0)
    start[1, 2] += [0.05, 0.08, 0.03]
    held = torch.tensor([True, True, False])
    result = solve(garment, material, start, mesh(FAR_AWAY, [0, 1, 2]), held=held, tolerance=1e-4)
    assert stretch > 1.01
    assert result.converged.all()
    np.testing.assert_allclose(result.vertices[:, 2].numpy(), [[0, 0, -stretch * height]] * 2, atol=1e-3)
    np.testing.assert_array_equal(result.vertices[:, :2].numpy(), start[:, :2].astype(np.float32))


def test_a_thread_holds_cloth_together():
    """A strip 5 cm wide lies in a U whose arms are 2 mm apart. One is held at its upper end; the other would slide
    down by 25 cm, but a thread joins it to the first. It pulls with the weight of that arm, at most 2 x 0.025 N: less
    than 0.1 mm at its stiffness."""
    columns, rows, spacing = 5, 41, 0.0125
    height = np.concatenate([np.arange(20)[::-1], [-0.5], np.arange(20)]) * spacing
    x, y = np.repeat([0.001, 0.0, -0.001], [20, 1, 20]), spacing * (np.arange(columns) - 2)
    vertices = np.stack(np.broadcast_arrays(x[:, None], y, height[:, None]), axis=2).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1, 1)
    faces = np.concatenate([corner + [0, columns, columns + 1], corner + [0, columns + 1, 1]])
    thread = np.array([[2, 2 + (rows - 1) * columns]])
    held, fell = torch.arange(len(vertices)) < columns, {}
    for threads in (thread, None):
        garment = Garment(vertices, faces, threads=threads)
        found = solve(garment, Material(), vertices[None], mesh(FAR_AWAY, [0, 1, 2]), held=held, tolerance=0.02)
        ends = found.vertices[0, thread[0]].numpy()
        fell[threads is None] = float(np.linalg.norm(ends[1] - ends[0]))
    assert 0.001 < fell[False] < 0.0021 and fell[True] > 0.2


def test_a_hanging_tube_reaches_the_minimum_of_the_oracle():
    """The oracle's float64 energy, minimised by SciPy's L-BFGS from the same start."""
    garment = tube(rings=4, segments=6, radius=0.1, height=0.15)
    material = Material(density=5.0, youngs_modulus=40.0, bending=2e-4)
    top = garment.vertices[:, 2] > garment.vertices[:, 2].max() - 1e-6
    direction = torch.tensor([0.0, 0, -1], dtype=torch.float64)

    def energy(free: np.ndarray):
        x = torch.tensor(garment.vertices)
        leaf = torch.tensor(free.reshape(-1, 3), requires_grad=True)
        x = x.index_put((torch.as_tensor(np.flatnonzero(~top)),), leaf)
        total = (
            oracle.stretch_energy(x, garment, material)
            + oracle.bend_energy(x, garment, material)
            + oracle.gravity_energy(x, garment, material, direction)
        )
        total.backward()
        return float(total.detach()), leaf.grad.numpy().reshape(-1)

    start = garment.vertices[~top].reshape(-1)
    expected = minimize(energy, start, jac=True, method="L-BFGS-B", options={"maxiter": 300, "gtol": 1e-6})
    result = solve(
        garment, material, garment.vertices[None], mesh(FAR_AWAY, [0, 1, 2]), held=torch.tensor(top), tolerance=1e-4
    )
    assert result.converged.all()
    assert expected.fun < energy(start)[0] - 1e-3
    assert result.energy.item() == pytest.approx(expected.fun, abs=1e-6)
    np.testing.assert_allclose(result.vertices[0].numpy()[~top].reshape(-1), expected.x, atol=2e-4)


def test_a_sheet_on_a_floor_sinks_in_as_far_as_its_weight_presses():
    """Weight a unit area rho g against contact 2 k depth. It falls onto the floor from above it."""
    garment = sheet(6, 0.2)
    material = Material(density=2.0, contact_stiffness=1e5)
    start = garment.vertices + [0, 0, 0.05]
    start[:, 2] += 0.01 * np.sin(40 * start[:, 0])
    result = solve(garment, material, start[None], mesh(FLOOR, [0, 1, 2, 0, 2, 3]), tolerance=1e-3)
    depth = material.density * 9.81 / (2 * material.contact_stiffness)
    assert result.converged.all()
    np.testing.assert_allclose(result.vertices[0, :, 2].numpy(), material.contact_offset - depth, atol=2e-6)


def test_cloth_in_a_groove_is_at_rest_though_neither_side_holds_it():
    """Two slopes meet under the sheet's middle row: its vertices end where the two sides are equally near."""
    garment = sheet(7, 0.12)
    groove = [[0, -9, 0], [0, 9, 0], [9, -9, 6], [9, 9, 6], [-9, -9, 6], [-9, 9, 6]]
    body = mesh(groove, [0, 3, 1, 0, 2, 3, 0, 1, 5, 0, 5, 4])
    material = Material(density=1.0, bending=1e-6, contact_stiffness=1e5)
    start = garment.vertices + [2e-3, 0, 0.03]
    result = solve(garment, material, start[None], body, tolerance=1e-3)
    assert result.converged.all()
    middle = result.vertices[0, 21:28].numpy()
    assert np.abs(middle[:, 0]).max() < 5e-5
    losses = PhysicsLosses(garment, material, 1, CPU)
    _, gradient = losses.evaluate(result.vertices, torch.tensor([[0.0, 0, -1]]), body, torch.zeros(1, 3))
    assert gradient.norm() > 10 * result.gradient_norm[0]


def test_a_clothed_body_several_samples_at_once(monkeypatch):
    """A band held at its upper rim: the energy falls in every iteration, each sample ends as low as it would alone, and
    convergence is told as it is."""
    body = load_body_model()
    band = tube(rings=9, segments=20, radius=1.0, height=0.3)
    garment = Garment(band.vertices * [0.19, 0.23, 1.0] + [0, 0, 0.12], band.faces)
    material = Material()
    generator = np.random.default_rng(0)
    positions = generator.uniform(0.5 * body.rig.lower, 0.5 * body.rig.upper, size=(3, len(body.rig.lower)))
    positions = torch.as_tensor(positions, dtype=torch.float32)
    top = torch.as_tensor(garment.vertices[:, 2] > garment.vertices[:, 2].max() - 1e-6)  # else it slides down the legs
    bodies = BodySet(body, body.held_out_bodies[:1], CPU)

    def run(chosen, tolerance=1e-3, **options):
        posed = PosedBodies(body, bodies, len(chosen))
        posed.pose(positions[chosen], torch.zeros(len(chosen), dtype=torch.int64))
        losses = PhysicsLosses(garment, material, len(chosen), CPU)
        start = torch.as_tensor(garment.vertices, dtype=torch.float32).repeat(len(chosen), 1, 1)
        down = torch.tensor([[0.0, 0, -1]] * len(chosen))
        solver = FullSpaceSolver(losses, held=top)
        return solver.minimise(start, down, posed.mesh, posed.offset, tolerance=tolerance, **options)

    seen, search = [], FullSpaceSolver.search
    monkeypatch.setattr(FullSpaceSolver, "search", lambda *given: seen.append(there := search(*given)) or there)
    together = run([0, 1, 2])
    energies = torch.stack([there.energy for there in seen])
    rise = (energies[1:] - energies[:-1]).max().item()
    assert rise < 1e-7, "no iteration may end higher than it started"
    assert energies[-1].sum() < energies[0].sum()
    assert together.converged.all()
    assert (together.gradient_norm <= 1e-3 * together.force_scale).all()
    for sample in range(3):
        alone = run([sample])
        assert alone.energy.item() == pytest.approx(together.energy[sample].item(), rel=0.02, abs=2e-4)
    short = run([0, 1, 2], iterations=1)
    assert not short.converged.any() and (short.iterations == 1).all()
    assert (short.gradient_norm > 1e-3 * short.force_scale).all()


@pytest.mark.parametrize("far", [np.nan, 1e20])
def test_a_start_without_a_finite_energy_is_rejected(far):
    """Not a number, or places so far apart that their energy overflows."""
    garment = sheet(3, 0.1)
    start = far * garment.vertices[None]
    with pytest.raises(ValueError, match="energy at the start is"):
        solve(garment, Material(), start, mesh(FAR_AWAY, [0, 1, 2]))
