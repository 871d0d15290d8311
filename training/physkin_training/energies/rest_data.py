"""Rest data of one garment in one or several rest shapes: what energies and strains are measured against.

Dimensions: `R` rest shapes, `n` vertices, `f` faces, `e` edges, `q` hinges. Metres.
"""

from __future__ import annotations

import numpy as np
import torch

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_core.runtime.frame_input import STANDARD_GRAVITY

__all__ = ["RestData", "face_rest_inverse", "hinge_rest"]


class RestData:
    """Tables with a row for every rest shape, float32 on one device.

    rest_inverse: (R, f, 2, 2) [1/m], see `face_rest_inverse`. face_area: (R, f), vertex_area: (R, n) [m2].
    edge_length: (R, e) [m]. hinge_angle: (R, q) [rad]. bend_stiffness: (R, q) [J]. weight: (R, n) [N].
    shapes: rest positions (R, n, 3), default the garment's own alone.
    """

    def __init__(
        self, garment: Garment, material: Material, device: torch.device, *, shapes: np.ndarray | None = None
    ) -> None:
        garments = [garment] if shapes is None else [garment.reshaped(vertices) for vertices in shapes]

        def table(rows: list[np.ndarray]) -> torch.Tensor:
            return torch.as_tensor(np.stack([row.astype(np.float32) for row in rows]), device=device)

        self.rest_inverse = table([face_rest_inverse(shape) for shape in garments])
        self.face_area = table([shape.face_areas for shape in garments])
        self.vertex_area = table([shape.vertex_areas for shape in garments])
        self.edge_length = table([shape.edge_lengths for shape in garments])
        self.weight = table([shape.vertex_areas * material.density * STANDARD_GRAVITY for shape in garments])
        hinges = [hinge_rest(shape) for shape in garments]
        kept = garment.creased if material.rest_angles == "flat" else True
        self.hinge_angle = table([np.where(kept, angle, 0.0) for angle, _ in hinges])
        self.bend_stiffness = table([material.bending * factor for _, factor in hinges])


def face_rest_inverse(garment: Garment) -> np.ndarray:
    """Inverse of the rest edge matrix of every face, (f, 2, 2) [1/m], see `Garment.rest_edges`."""
    (a, b), (c, d) = np.moveaxis(garment.rest_edges, 0, -1)
    return np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2) / (a * d - b * c)[:, None, None]


def hinge_rest(garment: Garment) -> tuple[np.ndarray, np.ndarray]:
    """Rest dihedral angle (q,) [rad] of the mesh, and 3 |e|^2 / (A_a + A_b) (q,) of its rest shape, of every hinge."""
    x0, x1, x2, x3 = (garment.vertices[garment.hinges[:, k]] for k in range(4))
    edge = x1 - x0
    na, nb = np.cross(edge, x2 - x0), np.cross(x3 - x0, edge)
    angle = np.arctan2((np.cross(na, nb) * edge).sum(axis=1) / np.linalg.norm(edge, axis=1), (na * nb).sum(axis=1))
    sides = garment.face_edges.reshape(-1)
    hinged = np.bincount(sides) == 2
    areas = np.bincount(sides, np.repeat(garment.face_areas, 3))
    return angle, 3 * garment.edge_lengths[hinged] ** 2 / areas[hinged]
