"""The low modes of a garment in its garment nodes' space: the ways in which it moves most easily.

They solve the generalised eigenproblem of the energy's second derivative, its mean over drapes at rest in everyday
poses, and the mass, both seen through skinning: vertices are linear in the garment nodes' numbers.

Dimensions: `K` modes, `m` garment nodes, `n` vertices, `P` poses. Metres, root frame.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.linalg import eigh
from scipy.sparse import coo_array, csr_array

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment_model import GarmentModel
from physkin_training.dynamics.dynamic_simulation import DynamicSimulation
from physkin_training.physics.energy_kernels import BAND_STIFFNESS

__all__ = ["garment_modes", "skinning_basis"]

REGULAR = 1e-3
"""Share of the mean diagonal added to the mass, for what of the garment nodes' numbers moves no vertex."""


def skinning_basis(model: GarmentModel) -> csr_array:
    """(n, 4 m): a vertex's coordinate is this times the same row of all garment nodes' transforms (4 m,)."""
    n, influences = model.influence_nodes.shape
    offset = model.garment.vertices[:, None] - model.node_rest[model.influence_nodes]
    terms = np.concatenate([offset, np.ones((n, influences, 1))], axis=2) * model.influence_weights[:, :, None]
    rows = np.repeat(np.arange(n), influences * 4)
    columns = (4 * model.influence_nodes[:, :, None] + np.arange(4)).reshape(-1)
    return coo_array((terms.reshape(-1), (rows, columns)), shape=(n, 4 * len(model.node_rest))).tocsr()


def garment_modes(
    model: GarmentModel, body_model: BodyModel, simulation: DynamicSimulation, *, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (K, m, 3, 4), of mass 1 kg, and angular frequencies (K,) [1/s] by the mean second derivative, of the
    first frames of all scenes of a simulation."""
    basis = skinning_basis(model)
    n, m = basis.shape[0], len(model.node_rest)
    spread = coo_array(basis)
    rows = (3 * spread.row[:, None] + np.arange(3)).reshape(-1)  # vertex coordinates from numbers (m, 3, 4)
    node, entry = spread.col // 4, spread.col % 4
    columns = (12 * node[:, None] + 4 * np.arange(3) + entry[:, None]).reshape(-1)
    jacobian = coo_array((np.repeat(spread.data, 3), (rows, columns)), shape=(3 * n, 12 * m)).tocsr()
    mass = np.repeat(simulation.potential.mass.mean(dim=0).double().cpu().numpy(), 3)
    with torch.no_grad():
        stiffness = mean_hessian(simulation)
    k = (jacobian.T @ (stiffness @ jacobian)).toarray()
    inertia = (jacobian.T @ (jacobian * mass[:, None])).toarray()
    inertia += REGULAR * np.trace(inertia) / len(inertia) * np.eye(len(inertia))
    squared, shapes = eigh(k, inertia, subset_by_index=[0, count - 1])
    return shapes.T.reshape(count, m, 3, 4), np.sqrt(np.maximum(squared, 0))


def mean_hessian(simulation: DynamicSimulation) -> csr_array:
    """(3 n, 3 n) [N/m] at rest, the mean over all samples; the band is held where it is."""
    solution = simulation.at_rest()
    potential, hessian = simulation.potential, simulation.static_hessian()
    hessian.active.fill_(True)
    exact = torch.zeros_like(hessian.active)
    potential.evaluate(solution.vertices, simulation.gravity(0), *simulation.bodies)
    hessian.assemble(solution.vertices, *simulation.bodies, exact)
    result = hessian.mean_matrix()
    band = potential.band_vertices
    stiffness = np.zeros(result.shape[0])
    area = potential.rest.vertex_area[0].double().cpu().numpy()
    for axis in range(3):
        stiffness[3 * band + axis] = 2 * BAND_STIFFNESS * area[band]
    return csr_array(result + coo_array((stiffness, (np.arange(len(stiffness)),) * 2), shape=result.shape))
