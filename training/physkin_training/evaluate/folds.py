"""How a drape's folds compare with those of the energy's minimum over all vertices, on the same pairs of body and pose.

Strain hardly tells folded cloth from smooth cloth, nor folds from noise; the eye does.
Dimensions: `B` samples of a batch, `n` garment vertices, `e` edges.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import torch
from torch.nn.functional import normalize

from physkin_core.model.garment import Garment
from physkin_training.physics.area_normals import area_normals

__all__ = ["FoldFigures", "averaged_with_neighbours"]

NEAR = 0.010
"""Normals are compared where a vertex is less than this far [m] from the minimum's: farther apart, a fold of the one
lies beside another of the other."""


class FoldFigures:
    """Compares drapes of one garment with minima, over batches."""

    def __init__(self, garment: Garment, device: torch.device) -> None:
        self._edges, self._faces = (
            torch.as_tensor(array.copy(), dtype=torch.int64, device=device) for array in (garment.edges, garment.faces)
        )
        self._sums: Counter[str] = Counter()

    def add(
        self,
        drapes: torch.Tensor,
        minima: torch.Tensor,
        bend: Callable[[torch.Tensor], torch.Tensor],
        *,
        normals: torch.Tensor | None = None,
        count: int | None = None,
    ) -> None:
        """Count in the first `count` (default all) of a batch of drapes and minima (B, n, 3) [m].

        bend: bending energies (B,) [J] of vertices (B, n, 3). normals: unit normals (B, n, 3) that the drapes are shown
        with, default those of their faces.
        """
        with torch.no_grad():
            for name, vertices in (("drape", drapes), ("minimum", minima)):
                energy = bend(vertices)
                self._count(f"{name} bend", energy[:count])
                self._count(f"{name} noise", (energy - bend(averaged_with_neighbours(vertices, self._edges)))[:count])
            own = self._face_normals(drapes) if normals is None else normals
            degrees = angles(own[:count], self._face_normals(minima)[:count])
            near = torch.linalg.norm(drapes - minima, dim=2)[:count] < NEAR
            self._count("degrees", degrees[near])
            self._count("near", near)

    def _face_normals(self, vertices: torch.Tensor) -> torch.Tensor:
        return normalize(area_normals(vertices, self._faces), dim=2)

    def _count(self, name: str, values: torch.Tensor) -> None:
        self._sums[name] += float(values.double().sum())

    def result(self) -> dict[str, float]:
        """`fold_energy_ratio` and `fold_noise_ratio`, drapes over minima, and `normal_error_degrees`, over all samples.

        Ratios are left out where minima have nothing to compare with, the angle where no vertex is near theirs.
        """
        sums, figures = self._sums, {}
        for figure, part in (("fold_energy_ratio", "bend"), ("fold_noise_ratio", "noise")):
            if sums[f"minimum {part}"] > 0:
                figures[figure] = sums[f"drape {part}"] / sums[f"minimum {part}"]
        if sums["near"]:
            figures["normal_error_degrees"] = sums["degrees"] / sums["near"]
        return figures


def averaged_with_neighbours(vertices: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    """Every vertex (B, n, 3) moved to the mean of itself and those that edges (e, 2) int64 join it with."""
    means, count = vertices.clone(), torch.ones(vertices.shape[1], device=vertices.device)
    for here, there in (edges.T, edges.flip(1).T):
        means.index_add_(1, here, vertices[:, there])
        count.index_add_(0, here, torch.ones(len(here), device=count.device))
    return means / count[:, None]


def angles(normals: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Between vectors (..., 3), in degrees (...)."""
    sine = torch.linalg.norm(torch.linalg.cross(normals, others), dim=-1)
    return torch.rad2deg(torch.atan2(sine, (normals * others).sum(dim=-1)))
