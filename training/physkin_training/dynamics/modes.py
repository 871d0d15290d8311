"""The low modes of a garment in its garment nodes' space: the ways in which it moves most easily.

They solve the generalised eigenproblem of the energy's second derivative, its mean over drapes at rest in everyday
poses, and the mass, both seen through skinning, by which the garment nodes' displacements move vertices.

Dimensions: `K` modes, `m` garment nodes, `n` vertices, `P` poses. Metres, root frame.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.linalg import eigh
from scipy.sparse import coo_array, csr_array, eye_array, kron

from physkin_core.model.garment_model import GarmentModel
from physkin_training.dynamics.dynamic_simulation import DynamicSimulation
from physkin_training.physics.energy_kernels import BAND_STIFFNESS

__all__ = ["garment_modes", "mean_hessian", "node_shares"]

REGULAR = 1e-4
"""Share of the mean diagonal added to the mass, for garment nodes that hardly move a vertex."""


def node_shares(model: GarmentModel) -> csr_array:
    """Skinning weights (n, m): how vertices move with garment nodes that do not turn."""
    n, influences = model.influence_nodes.shape
    place = (np.repeat(np.arange(n), influences), model.influence_nodes.reshape(-1))
    return coo_array((model.influence_weights.reshape(-1), place), shape=(n, len(model.node_rest))).tocsr()


def garment_modes(
    shares: csr_array, stiffness: csr_array, vertex_mass: np.ndarray, *, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (K, m, 3), displacements of garment nodes, of modal mass 1 kg; and angular frequencies (K,) [1/s].

    shares: see `node_shares`. stiffness: (3 n, 3 n) [N/m]. vertex_mass: (n,) [kg].
    """
    carried = kron(shares, eye_array(3)).tocsr()
    k = (carried.T @ (stiffness @ carried)).toarray()
    inertia = (carried.T @ (carried * np.repeat(vertex_mass, 3)[:, None])).toarray()
    inertia += REGULAR * np.trace(inertia) / len(inertia) * np.eye(len(inertia))
    squared, shapes = eigh(k, inertia, subset_by_index=[0, count - 1])
    return shapes.T.reshape(count, -1, 3), np.sqrt(np.maximum(squared, 0))


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
