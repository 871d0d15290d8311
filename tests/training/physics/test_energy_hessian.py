"""The second derivative of all energies together: products with it, its preconditioner, and which samples it is of."""

from __future__ import annotations

import numpy as np
import torch
from training.crumpled_tube import LINEAR_BEYOND, SAMPLES, CrumpledTube

from physkin_training.dynamics.step_solver import StepSolver


def test_it_is_the_sum_of_those_of_the_energies():
    together = CrumpledTube().matrix(exact=True)
    parts = [CrumpledTube(each.name).matrix(exact=True) for each in CrumpledTube().potential.energies]
    np.testing.assert_allclose(together, sum(parts), atol=1e-5 * np.abs(together).max())


def test_exact_and_positive_blocks_agree_at_the_rest_shape():
    tube = CrumpledTube(floor=-9.0, rows=[0, 0])
    tube.x = tube.rest
    tube.potential.begin(tube.rest, tube.rest)
    exact, positive = tube.matrix(exact=True), tube.matrix(exact=False)
    np.testing.assert_allclose(exact, positive, atol=1e-4 * np.abs(positive).max())


def test_the_preconditioner_inverts_the_diagonal_blocks_with_what_was_added():
    tube = CrumpledTube()
    matrix = tube.matrix(exact=False, sample=1)
    n = len(tube.garment.vertices)
    extra = torch.randn(SAMPLES, n, 3, 3, generator=torch.Generator().manual_seed(1))
    extra = extra @ extra.transpose(2, 3)
    tube.hessian.add_to_diagonal(extra)
    tube.hessian.add_to_diagonal(damping=torch.tensor([0.0, 50.0]))
    vector = torch.randn(SAMPLES, n, 3, generator=torch.Generator().manual_seed(2))
    result = tube.hessian.precondition(vector)[1].numpy()
    for v in range(n):
        block = matrix[3 * v : 3 * v + 3, 3 * v : 3 * v + 3] + extra[1, v].numpy()
        block = block + 50.0 * tube.garment.vertex_areas[v] * np.eye(3)
        np.testing.assert_allclose(block @ result[v], vector[1, v].numpy(), atol=2e-3)


def test_only_active_samples_are_worked_on():
    tube = CrumpledTube()
    tube.hessian.active.copy_(torch.tensor([False, True]))
    tube.assemble(exact=True)
    product = torch.full_like(tube.x, 7.0)
    tube.hessian.multiply(tube.x, product)
    assert (product[0] == 7.0).all() and not (product[1] == 7.0).any()
    tube.hessian.active.fill_(True)
    assert torch.equal(tube.product(tube.x)[0], torch.zeros_like(tube.x[0])), "nothing was assembled there"


def test_solvers_return_to_the_better_of_two_points_of_each_sample():
    tube = CrumpledTube(linear_beyond=LINEAR_BEYOND)
    solver = StepSolver(tube.hessian, torch.ones(tube.x.shape[1], dtype=torch.bool))
    solver.begin(tube.down, tube.body, tube.offset)
    products, points = [], []
    for seed in (0, 3):
        points.append(solver.point(tube.crumpled(seed)))
        solver.assemble()
        products.append(tube.product(tube.rest))
    solver._return_to(points[1].or_where(torch.tensor([True, False]), points[0]))
    solver.assemble()
    expected = torch.stack([products[0][0], products[1][1]])
    torch.testing.assert_close(tube.product(tube.rest), expected, rtol=0, atol=0)
    assert not torch.equal(products[0][0], products[1][0])
