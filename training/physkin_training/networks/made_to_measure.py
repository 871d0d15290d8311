"""Rest shapes of a garment on the bodies of a set: the template, and one made to measure for each body.

They are computed once; a training step only looks up the ones of its samples.

Dimensions: `B` samples, `S` bodies of the set, `n` garment vertices, `m` garment nodes. Metres, canonical pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from physkin_core.avatar.body_model import ADULT_STATURE, BodyModel
from physkin_core.model.garment import Garment
from physkin_core.runtime.garment_grading import GarmentGrading
from physkin_training.networks.draping import Drape, RestShape
from physkin_training.sampling.posed_bodies import BodySet

__all__ = ["MadeToMeasure", "Worn"]


@dataclass(frozen=True)
class Worn:
    """Rest shapes of samples: rows (B,) int64 of `MadeToMeasure.shapes`, node_positions (B, m, 3) of the garment nodes
    on the samples' bodies, and the rest shapes themselves."""

    rows: torch.Tensor
    node_positions: torch.Tensor
    rest: RestShape


class MadeToMeasure:
    """Row 0 of `shapes` (R, n, 3) float64, NumPy, is the template, the others are graded to the bodies: one for all of
    the same coefficients, whatever they wear under it, in the order of the first of these.

    small: (S,) bool, bodies smaller than adults. Nobody trains on what they would wear at the template.
    fit: how far from the template to the graded shape, 0 to 1. `node_positions` (2 S, m, 3): of all bodies at the
    template, then of all made to measure. Garment nodes go from where their bones carry them to where the graded
    garment has them, and at fit 1 rest there, so that the graded garment at the canonical pose is its own rest shape.
    """

    def __init__(
        self, garment: Garment, drape: Drape, bodies: BodySet, body_model: BodyModel, *, fit: float = 1.0
    ) -> None:
        device = drape.node_rest.device
        grading = GarmentGrading(garment, body_model)
        coefficients, row = _distinct(bodies.coefficients)
        displacement = fit * (grading.graded(coefficients) - garment.vertices)
        displacement = np.concatenate([np.zeros_like(displacement[:1]), displacement])
        self.shapes = garment.vertices + displacement
        self._vertices = torch.as_tensor(self.shapes, dtype=torch.float32, device=device)
        moved = displacement[:, grading.closest_vertices(drape.node_rest.cpu().numpy())]
        self._nodes = drape.node_rest + torch.as_tensor(moved, dtype=torch.float32, device=device)
        carried = drape.node_positions(bodies)
        self._row = torch.as_tensor(1 + row, device=device)
        self.small = torch.as_tensor(body_model.statures(bodies.coefficients) < ADULT_STATURE, device=device)
        graded = (1 - fit) * (carried - drape.node_rest) + self._nodes[self._row]
        self.node_positions = torch.cat([carried, graded])

    def shape_of(self, body: int) -> np.ndarray:
        """The rest shape (n, 3) of a body of the set."""
        return self.shapes[int(self._row[body])]

    def worn(self, body: torch.Tensor, made: torch.Tensor) -> Worn:
        """What samples wear. body: (B,) int64 into the set. made: (B,) bool, whether made to measure."""
        rows = torch.where(made, self._row[body], 0)
        positions = self.node_positions[body + made * len(self._row)]
        return Worn(rows, positions, RestShape(self._vertices[rows], self._nodes[rows]))


def _distinct(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows (S, c) that differ, in the order in which they come, and which of these each row is (S,)."""
    _, first, which = np.unique(coefficients, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return coefficients[first[order]], np.argsort(order)[which.reshape(-1)]
