"""A garment model carried over to another garment: what that can wear before it has trained, and trains from.

Networks, garment nodes and detail nodes are the model's own. Cloth takes its skinning weights and its detail from the
closest places of the model's cloth; where it reaches beyond that, it goes on as the edge there does.

Dimensions: `n` vertices, `v` those of the model's garment, `m` garment nodes, `D` detail nodes. Metres, canonical pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, eye_array
from scipy.spatial import cKDTree

from physkin_core.avatar.surface_matching import with_normals
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.model.garment_model import GarmentModel
from physkin_core.rig.linear_blend_skinning import dense_weights, strongest_influences

__all__ = ["Counterparts", "carried_model"]

MIXED = 3
"""Closest vertices whose weights are mixed, by the square of their distance."""
SOFTENED = 1e-3
"""[m] added to these distances: a vertex that lies on another takes that one's."""
SMOOTHED = 0.02
"""[m] Width over which weights that were taken over are smoothed: where the one garment has folds and the other none,
neighbours have counterparts far apart."""


@dataclass(frozen=True)
class Counterparts:
    """Where the vertices of a garment lie on another one's cloth that faces as they do: near (n, 3) indices of the
    closest vertices there, share (n, 3) of each, rows sum to 1, and distance (n,) [m] to the first."""

    near: np.ndarray
    share: np.ndarray
    distance: np.ndarray

    @classmethod
    def of(cls, garment: Garment, other: Garment) -> Counterparts:
        """Of the vertices of `garment` on `other`."""
        apart, near = cKDTree(_places(other)).query(_places(garment), k=MIXED)
        share = 1 / (apart + SOFTENED) ** 2
        distance = np.linalg.norm(garment.vertices - other.vertices[near[:, 0]], axis=1)
        return cls(near, share / share.sum(axis=1, keepdims=True), distance)

    def weights(self, nodes: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Weights of all nodes (n, m), of the other garment's influences: nodes (v, K), weights (v, K)."""
        dense = np.zeros((len(self.near), int(nodes.max()) + 1))
        for near, share in zip(self.near.T, self.share.T):
            dense += dense_weights(nodes[near], share[:, None] * weights[near], dense.shape[1])
        return dense


def carried_model(model: GarmentModel, garment: Garment, *, name: str) -> GarmentModel:
    """The model on another garment, called `name`: its rest normals are those of the mesh, it has no scores, and in
    `training` it says what it was `carried_from`."""
    there, smooth = Counterparts.of(garment, model.garment), _smoothing(garment)

    def carried(nodes: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, shares = strongest_influences(smooth @ there.weights(nodes, weights), nodes.shape[1])
        return found.astype(np.int32), shares

    influence_nodes, influence_weights = carried(model.influence_nodes, model.influence_weights)
    engine_nodes, engine_weights = carried(model.engine_nodes, model.engine_weights)
    detail = model.detail
    if detail is not None:
        nodes, weights = carried(detail.nodes, detail.weights)
        detail = replace(detail, nodes=nodes, weights=weights)
    return replace(
        model,
        name=name,
        garment=garment,
        rest_normals=vertex_normals(garment.vertices, garment.faces).astype(np.float32),
        influence_nodes=influence_nodes,
        influence_weights=influence_weights,
        engine_nodes=engine_nodes,
        engine_weights=engine_weights,
        detail=detail,
        training={"carried_from": model.name, "bending_octaves": list(model.bending_octaves)},
        scores={},
    )


def _smoothing(garment: Garment) -> csr_array:
    """(n, n) a mean over the cloth about each vertex, `SMOOTHED` wide: rounds of one half itself, one half its
    neighbours."""
    n = len(garment.vertices)
    pairs = np.concatenate([garment.edges, garment.edges[:, ::-1]]).T
    joined = coo_array((np.ones(pairs.shape[1]), pairs), shape=(n, n)).tocsr()
    once = (eye_array(n) + diags_array(1 / joined.sum(axis=1)) @ joined) / 2
    rounds = math.ceil(2 * (SMOOTHED / garment.edge_lengths.mean()) ** 2)
    return reduce(lambda so_far, _: so_far @ once, range(rounds), eye_array(n, format="csr"))


def _places(garment: Garment) -> np.ndarray:
    return with_normals(garment.vertices, vertex_normals(garment.vertices, garment.faces))
