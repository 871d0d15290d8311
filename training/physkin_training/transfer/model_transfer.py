"""A garment model for another garment: how that can be worn before training, and what training starts from.

Networks, garment nodes and detail nodes are the model's own. The mesh gets the folds of the model's garment, and takes
skinning weights and detail from the places where it lies on that. Cloth beyond the model's garment moves as its edge
does.

Dimensions: `n` vertices, `v` those of the model's garment, `m` garment nodes, `D` detail nodes. Metres, canonical pose.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array

from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.model.garment_model import GarmentModel
from physkin_core.rig.linear_blend_skinning import dense_weights, strongest_influences
from physkin_training.transfer.matched_folds import Counterparts, joined_vertices, match_folds

__all__ = ["transferred_model"]

SMOOTHED = 0.02
"""[m] Width over which weights are smoothed where neighbours lie far apart on the model's garment."""


def transferred_model(model: GarmentModel, garment: Garment, *, name: str) -> GarmentModel:
    """The model for another garment, called `name`, which gets the folds of the model's. Its rest normals are those of
    the mesh, it has no scores, and its `training` says what it was `transferred_from`."""
    matched = match_folds(garment, model.garment)
    garment = replace(garment, vertices=matched.vertices)
    smoothing = _smoothing(garment, matched.torn)

    def transferred(nodes: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, shares = strongest_influences(smoothing @ _weights(matched.there, nodes, weights), nodes.shape[1])
        return found.astype(np.int32), shares

    influence_nodes, influence_weights = transferred(model.influence_nodes, model.influence_weights)
    engine_nodes, engine_weights = transferred(model.engine_nodes, model.engine_weights)
    detail = model.detail
    if detail is not None:
        nodes, weights = transferred(detail.nodes, detail.weights)
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
        training={"transferred_from": model.name, "bending_octaves": list(model.bending_octaves)},
        scores={},
    )


def _weights(there: Counterparts, nodes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weights of all nodes (n, m), of the other garment's influences: nodes (v, K), weights (v, K)."""
    dense = np.zeros((len(there.near), int(nodes.max()) + 1))
    for near, share in zip(there.near.T, there.share.T):
        dense += dense_weights(nodes[near], share[:, None] * weights[near], dense.shape[1])
    return dense


def _smoothing(garment: Garment, torn: np.ndarray) -> csr_array:
    """(n, n): each vertex itself, but near torn (n,) ones a mean over the cloth about it, `SMOOTHED` wide."""
    joined = joined_vertices(garment)
    once = (eye_array(len(torn)) + diags_array(1 / joined.sum(axis=1)) @ joined) / 2
    rounds = math.ceil(2 * (SMOOTHED / garment.edge_lengths.mean()) ** 2)
    near = torn.astype(np.float64)
    for _ in range(rounds):
        near = np.maximum(near, once @ near)
    mean = diags_array(near) @ eye_array(len(torn), format="csr")
    for _ in range(rounds):
        mean = mean @ once
    return diags_array(1 - near) + mean
