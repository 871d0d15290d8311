"""Detail nodes on a mesh, and which of them each vertex goes with to begin with.

Dimensions: `n` vertices, `D` detail nodes, `J` of them a vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_training.config import DetailConfig
from physkin_training.networks.garment_nodes import initial_skinning_weights, sample_garment_nodes

__all__ = ["DetailNodeSet"]


@dataclass(frozen=True)
class DetailNodeSet:
    """count: D. features: numbers that move them. influence_nodes (n, J), influence_weights (n, J)."""

    count: int
    features: int
    influence_nodes: np.ndarray
    influence_weights: np.ndarray

    @classmethod
    def sample(cls, garment: Garment, config: DetailConfig) -> DetailNodeSet | None:
        """Spread as garment nodes are, all vertices of a mesh that has no more; None where there are to be none."""
        if config.nodes == 0:
            return None
        vertices = len(garment.vertices)
        if config.nodes >= vertices:
            return cls(vertices, config.features, np.arange(vertices)[:, None], np.ones((vertices, 1)))
        _, distances = sample_garment_nodes(garment, config.nodes)
        return cls(config.nodes, config.features, *initial_skinning_weights(garment, distances, config.influences))

    @classmethod
    def of_model(cls, model: GarmentModel) -> DetailNodeSet | None:
        """Those of a garment model; None where it has none."""
        if (detail := model.detail) is None:
            return None
        numbers, features = detail.offsets.shape
        return cls(numbers // 3, features, detail.nodes, detail.weights)
