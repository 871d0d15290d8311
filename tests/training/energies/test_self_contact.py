"""Self-contact on sheets of cloth: its values and derivatives against a naive loop, which side cloth keeps to, and that
a minimiser does not let it through."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from physkin_core.model.garment import Garment, load_garment, vertex_normals
from physkin_core.model.garment_model import Material
from physkin_prepare.wardrobe import PATTERNS
from physkin_training.contact.touching_places import FAR, FOLDED_FROM, TouchingPlaces
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.self_contact import DEEPEST, OFFSET, SOFTNESS
from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.physics.full_space_solver import FullSpaceSolver
from physkin_training.physics.physics_losses import PhysicsLosses

CPU, MATERIAL = torch.device("cpu"), Material()
DOWN = torch.tensor([[0.0, 0.0, -1.0]])
EDGE = 0.01


def sheet(columns: int, rows: int, *, up: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """A flat sheet about the origin whose outside faces up, or down; vertex (row, column) is row * columns + column."""
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    vertices = EDGE * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    index = np.arange(x.size).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    return vertices, faces if up else faces[:, ::-1]


def two_sheets(place: list[float], *, up: bool = True) -> tuple[Garment, np.ndarray]:
    """A large one at the origin, and a small one; also which vertices are the small one's (n,)."""
    (large, large_faces), (small, small_faces) = sheet(13, 13), sheet(6, 6, up=up)
    garment = Garment(np.concatenate([large, small + place]), np.concatenate([large_faces, small_faces + len(large)]))
    return garment, np.arange(len(garment.vertices)) >= len(large)


def losses_of(garment: Garment, *shapes: np.ndarray, samples: int = 1, feels: bool = True) -> PhysicsLosses:
    """Of cloth that may lie as it was made and as in `shapes`; it is worn on nothing."""
    n = len(garment.vertices)
    inside_out = np.zeros(n, dtype=bool)
    none, index = np.zeros((n, 1), dtype=bool), np.zeros(n, dtype=np.int32)
    wearing = Wearing(
        *(np.zeros((1, 3), np.int32), np.zeros(1, np.int32), none, none, np.zeros(1, bool), index, index - 1),
        *(index[:0], index[:0], np.zeros(0, np.float32), inside_out),
        TouchingPlaces.find(garment, [garment.vertices, *shapes], inside_out) if feels else None,
    )
    return PhysicsLosses(garment, MATERIAL, samples, CPU, wearing=wearing)


def nowhere() -> wp.Mesh:
    """A body far away."""
    wp.config.quiet = True
    wp.init()
    corners = np.array([[9, 9, 9], [10, 9, 9], [9, 10, 9]], dtype=np.float32)
    return wp.Mesh(wp.array(corners, dtype=wp.vec3, device="cpu"), wp.array([0, 1, 2], dtype=wp.int32, device="cpu"))


def felt(losses: PhysicsLosses, *drapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Energies (B, n) of self-contact alone and their summed gradient (B, n, 3) [N]."""
    x = torch.as_tensor(np.stack(drapes), dtype=torch.float32)
    body, at = nowhere(), torch.zeros(len(x), 3)
    _, whole = losses.evaluate(x, DOWN.repeat(len(x), 1), body, at)
    itself = next(each for each in losses.energies if each.name == "self_contact")
    gradient = torch.zeros_like(x)
    losses.drapes.gradient = wp.from_torch(gradient, dtype=wp.vec3)
    itself.evaluate(losses.drapes)
    return itself.values.double().numpy(), gradient.double().numpy()


def crumpled(garment: Garment, small: np.ndarray, seed: int) -> np.ndarray:
    """The small sheet lies on the large one, through it in places; neither is flat."""
    noise = np.random.default_rng(seed).normal(scale=1.5e-3, size=garment.vertices.shape)
    return garment.vertices + noise + np.where(small[:, None], [0.003, 0.002, -0.009], 0)


def naive(garment: Garment, x: np.ndarray, small: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energies (n,), gradient (3 n,) and second derivative of sheets of which the small one stays above, by a loop over
    all vertices and all faces of the other sheet."""
    n, faces = len(x), garment.faces
    energy, gradient, matrix = np.zeros(n), np.zeros(3 * n), np.zeros((3 * n, 3 * n))
    areas = garment.vertex_areas
    for v in range(n):
        best = None
        for face in faces[small[faces[:, 0]] != small[v]]:
            a, b, c = x[face]
            normal = np.cross(b - a, c - a)
            inside = np.linalg.solve(np.stack([b - a, c - a, normal], axis=1), x[v] - a)[:2]
            tried = [np.array([1 - inside.sum(), *inside])]
            if tried[0].min() < 0:
                tried = []
                for i, j in ((0, 1), (1, 2), (2, 0)):
                    edge = x[face[j]] - x[face[i]]
                    t = np.clip((x[v] - x[face[i]]) @ edge / (edge @ edge), 0, 1)
                    tried.append(np.eye(3)[i] * (1 - t) + np.eye(3)[j] * t)
            for weight in tried:
                gap = x[v] - weight @ x[face]
                if best is None or gap @ gap < best[0]:
                    best = gap @ gap, gap, weight, face, normal / np.linalg.norm(normal)
        squared, gap, weight, face, normal = best
        out = normal * (1 if small[v] else -1)
        distance = np.sqrt(squared) * np.sign(gap @ out)
        if abs(gap @ out) < 0.7 * abs(distance) or not 0 < OFFSET - distance <= DEEPEST:
            continue
        k = SOFTNESS * MATERIAL.contact_stiffness * areas[v]
        row = np.zeros((n, 3))
        row[v] += gap / distance
        row[face] -= weight[:, None] * gap / distance
        energy[v] = k * (OFFSET - distance) ** 2
        gradient -= 2 * k * (OFFSET - distance) * row.ravel()
        matrix += 2 * k * np.outer(row.ravel(), row.ravel())
    return energy, gradient, matrix


def test_values_gradient_and_second_derivative_are_those_of_a_naive_loop():
    """Of two samples at once. The second derivative is compared with that of planes that keep their direction, as it is
    computed, and is positive then. In these drapes no vertex is closest to a face beyond those around its place."""
    garment, small = two_sheets([0.0, 0.0, 0.01])
    losses = losses_of(garment, samples=2)
    drapes = crumpled(garment, small, 1), crumpled(garment, small, 4)
    energies, gradient = felt(losses, *drapes)
    losses.energies = [each for each in losses.energies if each.name == "self_contact"]
    hessian = EnergyHessian(losses)
    hessian.assemble(torch.tensor([True, False]))
    for sample, x in enumerate(drapes):
        energy, force, matrix = naive(garment, x, small)
        assert (energy > 0).sum() > 20
        np.testing.assert_allclose(energies[sample], energy, atol=1e-4 * energy.max())
        np.testing.assert_allclose(gradient[sample].ravel(), force, atol=2e-3 * np.abs(force).max())
        np.testing.assert_allclose(gradient[sample].sum(axis=0), 0, atol=1e-5 * np.abs(force).sum())
        hessian.active.copy_(torch.arange(2) == sample)
        columns = []
        for way in np.random.default_rng(2).normal(size=(5, *x.shape)):
            product = torch.full((2, *x.shape), 7.0)
            hessian.multiply(torch.as_tensor(np.stack([way, way]), dtype=torch.float32), product)
            assert (product[1 - sample] == 7).all()
            expected = matrix @ way.ravel()
            np.testing.assert_allclose(product[sample].ravel().numpy(), expected, atol=5e-3 * np.abs(expected).max())
            columns.append(way.ravel() @ product[sample].double().ravel().numpy())
        assert min(columns) > 0


def test_the_gradient_is_that_of_the_energy():
    garment, small = two_sheets([0.0, 0.0, 0.01])
    losses, x = losses_of(garment), crumpled(garment, small, 3)
    _, gradient = felt(losses, x)
    for seed in range(4):
        way = 2e-5 * np.random.default_rng(seed).normal(size=x.shape)
        change = felt(losses, x + way)[0].sum() - felt(losses, x - way)[0].sum()
        assert change / 2 == pytest.approx((gradient[0] * way).sum(), rel=0.02)


@pytest.mark.parametrize("above, up", [(0.01, True), (-0.01, True), (0.01, False), (-0.01, False)])
def test_cloth_that_lay_on_cloth_as_it_was_made_stays_on_that_side(above, up):
    """Whichever way either faces: over a placket, or under a collar that is turned."""
    garment, small = two_sheets([0.0, 0.0, above], up=up)
    losses = losses_of(garment)
    assert felt(losses, garment.vertices)[0].max() == 0
    through = garment.vertices - np.where(small[:, None], [0, 0, 1.5 * above], 0)
    energies, gradient = felt(losses, through)
    assert (energies[0, small] > 0).all() and (energies[0, ~small] > 0).sum() > 9
    assert np.sign(-gradient[0, small].sum(axis=0)[2]) == np.sign(above)


@pytest.mark.parametrize("up, counts", [(False, True), (True, False)])
def test_the_outsides_of_cloth_that_was_made_apart_meet(up, counts):
    """The sheets were made beside each other and lay on each other later; with a common direction one is beyond."""
    garment, small = two_sheets([0.2, 0.0, 0.02], up=up)
    on = garment.vertices - np.where(small[:, None], [0.2, 0, 0.01], 0)
    losses = losses_of(garment, on)
    assert felt(losses, on)[0].max() == 0
    through = on - np.where(small[:, None], [0, 0, 0.02], 0)
    assert (felt(losses, through)[0][0, small] > 0).all() == counts
    assert (felt(losses, through)[0].max() > 0) == counts
    assert felt(losses, through - np.where(small[:, None], [0, 0, DEEPEST], 0))[0].max() == 0, "another sheet"


def test_a_fold_does_not_feel_its_other_side():
    """Which side of it belongs where cannot be told from how it hangs."""
    flat, faces = sheet(17, 7)
    garment = Garment(flat, faces)
    folded = np.stack([0.1 * np.abs(flat[:, 0]), flat[:, 1], np.abs(flat[:, 0])], axis=1)
    losses = losses_of(garment, folded)
    assert felt(losses, folded)[0].max() == 0
    assert (next(each for each in losses.energies if each.name == "self_contact").elements).size > 0


@pytest.mark.parametrize("name", ("blazer", "coat"))
def test_lapels_as_they_were_made(name):
    """They are rolled over, nowhere nearer to the front than 3 mm. A single vertex 2 cm on the wrong side of cloth
    would have 0.04 J, layers that are told apart by mistake alone, at most 5 mm, 0.004 J."""
    garment = load_garment(PATTERNS.parent / f"{name}.obj")
    energies, _ = felt(losses_of(garment), garment.vertices)
    assert energies.sum() < 0.03 and energies.max() < 0.01


@pytest.mark.parametrize("feels", [True, False])
def test_a_minimiser_does_not_let_cloth_through(feels):
    """A small sheet falls on a large one, which is held; without self-contact it falls on."""
    garment, small = two_sheets([0.0, 0.0, 0.006])
    solver = FullSpaceSolver(losses_of(garment, feels=feels), held=torch.as_tensor(~small))
    start = torch.as_tensor(garment.vertices[None], dtype=torch.float32)
    found = solver.minimise(start, DOWN, nowhere(), torch.zeros(1, 3), iterations=40)
    height = found.vertices[0, small, 2].numpy()
    if feels:
        assert found.converged.all() and height.min() > 0.9 * OFFSET and height.max() < 1.1 * OFFSET
    else:
        assert height.max() < -0.05


def test_without_places_nothing_is_felt():
    garment, small = two_sheets([0.0, 0.0, 0.01])
    losses = losses_of(garment, feels=False)
    energies, gradient = felt(losses, crumpled(garment, small, 0))
    assert energies.size == 0 and not gradient.any()
    assert vertex_normals(garment.vertices, garment.faces)[0, 2] == 1


def test_a_fall_feels_the_stand_that_it_was_made_upon():
    """A strip folded over, 5 mm apart: what is 4.5 cm and more along the cloth keeps to the side on which it was made,
    though it is nearer than places are that meet in poses."""
    rows, columns = 13, 5
    along = EDGE * (np.arange(rows) - (rows - 1) / 2)
    x, y = np.meshgrid(along, EDGE * np.arange(columns), indexing="ij")
    vertices = np.stack([np.abs(x).ravel(), y.ravel(), np.where(x < 0, 0.0, 0.005).ravel()], axis=1)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    garment = Garment(vertices, faces)
    assert FOLDED_FROM < np.ptp(along) + 0.005 < FAR
    losses = losses_of(garment)
    assert not felt(losses, vertices)[0].any()
    end = np.arange(len(vertices)) >= len(vertices) - columns
    pushed = vertices - np.where(end[:, None], [0, 0, 0.008], 0)
    energy, gradient = felt(losses, pushed)
    assert energy[0, end].all()
    assert (gradient[0, end, 2] < 0).all()
