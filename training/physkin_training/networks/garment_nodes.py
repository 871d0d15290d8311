"""Garment nodes and detail nodes on a mesh: farthest-point sampling and initial weights from heat-method distances.

Paper: Node-based Skinning for Garments. Dimensions: `n` vertices, `m` garment nodes, `K` of them a vertex, `D` detail
nodes, `J` of them a vertex. Metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.garment_nodes import closest_bones
from physkin_core.model.surface_paths import pieces
from physkin_core.rig.rig import Rig
from physkin_training.config import DetailConfig

__all__ = ["DetailNodeSet", "GarmentNodeSet", "initial_skinning_weights", "sample_garment_nodes"]


@dataclass(frozen=True)
class GarmentNodeSet:
    """Garment nodes of a garment: rest (m, 3) [m], bone (m,) int32, and initial skinning by `influence_nodes`,
    `influence_weights` (n, K)."""

    rest: np.ndarray
    bone: np.ndarray
    influence_nodes: np.ndarray
    influence_weights: np.ndarray

    @classmethod
    def sample(cls, garment: Garment, rig: Rig, count: int, influences: int) -> GarmentNodeSet:
        """Farthest-point garment nodes with heat-method skinning weights, each bound to its closest bone."""
        vertices, distances = sample_garment_nodes(garment, count)
        rest = garment.vertices[vertices]
        nodes, weights = initial_skinning_weights(garment, distances, influences)
        return cls(rest, closest_bones(rest, rig.heads, rig.tails), nodes, weights)

    @classmethod
    def of_model(cls, model: GarmentModel) -> GarmentNodeSet:
        """Those of a garment model, with its skinning weights."""
        return cls(model.node_rest, model.node_bone, model.influence_nodes, model.influence_weights)


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


def sample_garment_nodes(garment: Garment, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Farthest-point sampling over geodesic (heat method) distance, one garment node at least in every connected piece.

    Starts, in every piece, at the vertex farthest from the piece's centroid. Returns vertex indices (m,) int64 and the
    distances (m, n) [m] from every garment node to every vertex, infinite to other pieces. Raises ValueError when the
    garment has fewer vertices or more pieces, or a vertex that no face uses.
    """
    n = len(garment.vertices)
    if not 1 <= count <= n:
        raise ValueError(f"cannot sample {count} garment nodes from {n} vertices; allowed 1 to {n}")
    pieces = [_Piece(garment, members) for members in _connected_pieces(garment)]
    if count < len(pieces):
        raise ValueError(f"cannot cover {len(pieces)} separate pieces of the garment with {count} garment nodes")
    piece_of = np.empty(n, dtype=np.int64)
    for index, piece in enumerate(pieces):
        piece_of[piece.members] = index
    nodes, distances = [], []
    nearest = np.full(n, np.inf)
    while len(nodes) < count:
        node = pieces[len(nodes)].start if len(nodes) < len(pieces) else int(nearest.argmax())
        nodes.append(node)
        distances.append(pieces[piece_of[node]].distances(node, n))
        np.minimum(nearest, distances[-1], out=nearest)
    return np.array(nodes), np.maximum(np.stack(distances), 0.0)


class _Piece:
    """One connected piece with a heat-method solver of its own: across a gap the method gives arbitrary numbers."""

    def __init__(self, garment: Garment, members: np.ndarray) -> None:
        import potpourri3d

        self.members = members
        vertices = garment.vertices[members]
        faces = garment.faces[np.isin(garment.faces[:, 0], members)]
        if len(faces) == 0:
            raise ValueError(f"garment vertex {members[0]} belongs to no face; remove it from the mesh")
        self._solver = potpourri3d.MeshHeatMethodDistanceSolver(vertices, np.searchsorted(members, faces))
        self.start = int(members[np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).argmax()])

    def distances(self, node: int, n: int) -> np.ndarray:
        """(n,) [m] from a vertex of this piece, infinite outside it."""
        result = np.full(n, np.inf)
        result[self.members] = self._solver.compute_distance(int(np.searchsorted(self.members, node)))
        return result


def _connected_pieces(garment: Garment) -> list[np.ndarray]:
    label = pieces(garment.edges, len(garment.vertices))
    return [np.flatnonzero(label == piece) for piece in range(label.max() + 1)]


def initial_skinning_weights(garment: Garment, distances: np.ndarray, influences: int) -> tuple[np.ndarray, np.ndarray]:
    """w = exp(-d / spacing) over the closest garment nodes, spacing being the mean node spacing sqrt(area / m) [m].

    distances: (m, n), infinite to other pieces of the garment (weight 0). Returns node indices (n, K) int64, closest
    first, and weights (n, K), rows summing to 1.
    """
    m = len(distances)
    spacing = math.sqrt(garment.face_areas.sum() / m)
    order = np.argsort(distances, axis=0, kind="stable")[: min(influences, m)].T
    weights = np.exp(-np.take_along_axis(distances.T, order, axis=1) / spacing)
    return order, weights / weights.sum(axis=1, keepdims=True)
