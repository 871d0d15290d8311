"""Energy minima: known equilibria, and the order start > subspace minimum > full-space minimum on a clothed body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the [training] extra")
wp = pytest.importorskip("warp", reason="needs the [training] extra")

from random_models import random_model, random_rotation, tube  # noqa: E402

from physkin_core import Garment, load_body_model  # noqa: E402
from physkin_core.garment_model import Material  # noqa: E402
from physkin_core.garment_nodes import closest_bones  # noqa: E402
from physkin_training.draping import compose_nodes, delta_transforms  # noqa: E402
from physkin_training.evaluate import Evaluation  # noqa: E402
from physkin_training.export import drape_from_model  # noqa: E402
from physkin_training.minimum import full_space_minimum, subspace_minimum  # noqa: E402
from physkin_training.physics_losses import PhysicsLosses  # noqa: E402

CPU = torch.device("cpu")
FAR_AWAY = np.array([[50.0, 0, 0], [51, 0, 0], [50, 1, 0]], dtype=np.float32)


@pytest.fixture(autouse=True, scope="module")
def quiet():
    wp.config.quiet = True
    wp.init()


def energy_of(garment, material, gravity):
    """Mean total energy of drapes (B, n, 3) with no body near."""
    body = wp.Mesh(
        wp.array(FAR_AWAY, dtype=wp.vec3, device="cpu"), wp.array(np.arange(3, dtype=np.int32), device="cpu")
    )
    losses = PhysicsLosses(garment, material, len(gravity), CPU)
    return lambda x: losses(x, gravity, body, torch.zeros(len(gravity), 3))[0]


@pytest.mark.parametrize("density", [2.0, 20.0])
def test_a_triangle_hanging_from_two_corners(density):
    """Pinned at two corners, pulled down by its own weight at the third. With height h stretched to lambda h, stress is
    along the pull only as far as the free corner feels it: E / (1 - nu^2) lambda (lambda^2 - 1) / 2 = rho g h / 3."""
    height = 0.3
    garment = Garment(np.array([[-0.2, 0, 0], [0.2, 0, 0], [0, 0, -height]]), np.array([[0, 1, 2]]))
    material = Material(density=density)
    stiffness = material.youngs_modulus / (1 - material.poisson_ratio**2)
    roots = np.roots([1, 0, -1, -2 * density * 9.81 * height / 3 / stiffness])
    (stretch,) = (root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 1)
    total = energy_of(garment, material, torch.tensor([[0.0, 0, -1]] * 2))
    pins = torch.tensor(garment.vertices[:2], dtype=torch.float32).expand(2, 2, 3)
    start = torch.tensor(garment.vertices, dtype=torch.float32).repeat(2, 1, 1)
    start[1, 2] += torch.tensor([0.05, 0.08, 0.03])

    def pinned(x):
        return total(torch.cat([pins, x[:, 2:]], dim=1))

    result = full_space_minimum(pinned, start, steps=1500, rate=2e-3).vertices
    assert stretch > 1.01
    for sample in range(2):
        np.testing.assert_allclose(result[sample, 2].detach().numpy(), [0, 0, -stretch * height], atol=1e-3)
    assert torch.equal(result[:, :2], start[:, :2]), "nothing pulls at the pins' own copies"


def test_stretched_cloth_returns_to_its_rest_lengths():
    """Without gravity the minimum of the elastic energy is none at all, in whatever place."""
    garment = tube(rings=4, segments=8)
    material = Material(density=1e-9)
    total = energy_of(garment, material, torch.tensor([[0.0, 0, -1]]))
    start = 1.15 * torch.tensor(garment.vertices, dtype=torch.float32)[None]
    result = full_space_minimum(total, start, steps=800).vertices
    assert total(start).item() > 1e-2
    assert total(result).item() < 1e-4 * total(start).item()
    ends = result[0].detach().numpy()[garment.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    np.testing.assert_allclose(lengths, garment.edge_lengths, rtol=5e-3)


def test_the_start_is_left_alone():
    start = torch.rand(2, 5, 3, requires_grad=True)
    before = start.detach().clone()
    result = full_space_minimum(lambda x: x.square().mean(), start, steps=50, rate=1e-2).vertices
    assert torch.equal(start, before) and start.grad is None
    assert result.abs().mean() < before.abs().mean()


def test_the_result_is_detached():
    minimum = full_space_minimum(lambda x: x.square().mean(), torch.rand(1, 5, 3), steps=1)
    assert not minimum.vertices.requires_grad and not minimum.gradient_norm.requires_grad


def test_gradient_norms_are_those_at_the_end():
    """By sample, and whatever the number of samples: of (w x)^2 / 2 it is w^2 |x|."""
    factor = torch.tensor([1.0, 3.0])[:, None, None]
    start = torch.rand(2, 5, 3)
    minimum = full_space_minimum(lambda x: (factor * x).square().sum() / 2 / len(x), start, steps=3)
    expected = torch.linalg.vector_norm(factor**2 * minimum.vertices, dim=(1, 2))
    torch.testing.assert_close(minimum.gradient_norm, expected)


@pytest.mark.parametrize("node_outputs", [9, 12])
def test_subspace_finds_a_drape_that_the_nodes_can_reach(node_outputs):
    """The energy is the squared distance to a drape made with known node numbers; sheared ones only 12 can reach."""
    rng = np.random.default_rng(0)
    model = random_model(rng, nodes=4, node_outputs=node_outputs)
    drape = drape_from_model(model)
    posed = torch.as_tensor(
        np.array([[np.c_[random_rotation(rng), rng.normal(size=3)] for _ in range(4)] for _ in range(2)]),
        dtype=torch.float32,
    )

    def shape(raw):
        return drape.skin(compose_nodes(posed, delta_transforms(raw)))

    with torch.no_grad():
        target = shape(torch.as_tensor(0.1 * rng.normal(size=(2, 4, node_outputs)), dtype=torch.float32))
        sheared = shape(torch.as_tensor(0.1 * rng.normal(size=(2, 4, 12)), dtype=torch.float32))
    start = torch.zeros(2, 4, node_outputs)

    def distance(result, target):
        return (result - target).square().sum(dim=-1).mean().sqrt().item()

    steps = 600 if node_outputs == 9 else 1500  # sheared nodes pull at each other and settle more slowly
    for goal, reachable in ((target, True), (sheared, node_outputs == 12)):
        result = subspace_minimum(lambda x, goal=goal: (x - goal).square().mean(), drape, posed, start, steps=steps)
        before, after = distance(shape(start), goal), distance(result.vertices, goal)
        assert before > 0.02 and after < before
        assert (after < 1e-3) == reachable


def test_samples_of_a_batch_are_minimised_apart():
    """The mean over a batch, yet each sample ends where it would alone."""
    targets = torch.rand(3, 4, 3, generator=torch.Generator().manual_seed(0))
    together = full_space_minimum(lambda x: (x - targets).square().mean(), torch.zeros(3, 4, 3), steps=400, rate=1e-2)
    for sample in range(3):
        goal = targets[sample : sample + 1]
        start = torch.zeros(1, 4, 3)
        alone = full_space_minimum(lambda x, g=goal: (x - g).square().mean(), start, steps=400, rate=1e-2)
        torch.testing.assert_close(together.vertices[sample], alone.vertices[0], atol=1e-4, rtol=0)


def test_minima_on_a_clothed_body_are_in_order():
    """The model's energy is above the subspace minimum's, and that above the full-space minimum's; gravity included."""
    body = load_body_model()
    band = tube(rings=9, segments=20, radius=1.0, height=0.3)
    garment = Garment(band.vertices * [0.19, 0.23, 1.0] + [0, 0, 0.12], band.faces)
    model = random_model(
        np.random.default_rng(1), rig=body.rig, garment=garment, nodes=12, influences=6, correction=0.005
    )
    model = replace(model, node_bone=closest_bones(model.node_rest, body.rig.heads, body.rig.tails))
    evaluation = Evaluation(model, CPU, bodies=1, poses=2, seed=0)
    rows = evaluation.minima(count=2, steps=300)
    assert list(rows) == ["model", "subspace_minimum", "minimum"]
    total = {name: row["energy_j"] + row["gravity_j"] for name, row in rows.items()}
    assert total["minimum"] < total["subspace_minimum"] < total["model"]
    assert rows["minimum"]["edge_strain_percent"] < 0.5 * rows["model"]["edge_strain_percent"]
    assert all(0 < rows[name]["gradient_norm"] < np.inf for name in ("subspace_minimum", "minimum"))
    again = evaluation.minima(count=2, steps=300)
    assert again == rows
