"""The quality figures of many drapes on one device: twin of `physkin_core.quality`, in batches.

Dimensions: `B` samples of a batch, `n` garment vertices.
"""

from __future__ import annotations

from collections import Counter

import torch

from physkin_core.model.garment import Garment
from physkin_core.quality import CLOSE
from physkin_training.energies.rest_data import RestData
from physkin_training.physics.physics_losses import Energies

__all__ = ["SNAP", "Figures"]

SNAP = 0.04
"""[m] Cloth snaps from one place to another in a frame in which some vertex's second difference exceeds that of nine
tenths of the vertices by more than this. Jitter does not show it: its mean hardly moves when a sleeve jumps across an
arm. Meant for 60 frames a second."""


class Figures:
    """Accumulates the quality figures over batches. rest: strains are against these rest shapes, default the garment's
    own."""

    def __init__(self, garment: Garment, device: torch.device, *, rest: RestData | None = None) -> None:
        def tensor(array, dtype: torch.dtype) -> torch.Tensor:
            return torch.as_tensor(array.copy(), dtype=dtype, device=device)

        self.edges = tensor(garment.edges, torch.int64)
        self.edge_lengths = tensor(garment.edge_lengths, torch.float32)[None] if rest is None else rest.edge_length
        self.faces = tensor(garment.faces, torch.int64)
        self.face_areas = tensor(garment.face_areas, torch.float32)[None] if rest is None else rest.face_area
        self.sums: Counter[str] = Counter()
        self.frames: Counter[str] = Counter()
        self.samples = 0
        self.depths: list[torch.Tensor] = []
        self._last: tuple[torch.Tensor, torch.Tensor] | None = None

    def add(
        self,
        vertices: torch.Tensor,
        energies: Energies,
        *,
        rest_row: torch.Tensor | None = None,
        takes: torch.Tensor | None = None,
        count: int | None = None,
    ) -> None:
        """Count in the first `count` (default all) of a batch of drapes (B, n, 3) [m].

        rest_row: (B,) integers, which rest shape each has, default the first. takes: (B,) int64, for drapes that are
        frames of motion, the take that each is of: a take's frames come together and in order, over as many batches as
        need be, and jitter, as of `physkin_core.quality`, and snaps (`SNAP`) are of each take by itself.
        """
        vertices = vertices[:count]
        ends = vertices[:, self.edges]
        length = torch.linalg.norm(ends[:, :, 1] - ends[:, :, 0], dim=-1)
        corners = vertices[:, self.faces]
        cross = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        area = torch.linalg.norm(cross, dim=-1) / 2
        distance = energies.signed_distance[:count]
        row = torch.zeros(len(vertices), dtype=torch.int64) if rest_row is None else rest_row[:count]
        lengths, areas = self.edge_lengths[row], self.face_areas[row]
        per_sample = {
            "edge_strain_percent": 100 * ((length - lengths).abs() / lengths).mean(dim=1),
            "area_strain_percent": 100 * ((area - areas).abs() / areas).mean(dim=1),
            "inside_percent": 100 * (distance < 0).float().mean(dim=1),
            "inside_worn_percent": 100 * ((distance < 0) & energies.at_worn_part[:count]).float().mean(dim=1),
            "within_3mm_percent": 100 * (distance < CLOSE).float().mean(dim=1),
            "stretch_j": energies.stretch[:count],
            "bend_j": energies.bend[:count],
            "collision_j": energies.collision[:count],
            "gravity_j": energies.gravity[:count],
        }
        for name, values in per_sample.items():
            self.sums[name] += float(values.double().sum())
        self.depths.append((-distance).amax(dim=1).clamp_min(0))
        self.samples += len(vertices)
        if takes is not None:
            self._add_frames(vertices, takes[:count])

    def _add_frames(self, vertices: torch.Tensor, takes: torch.Tensor) -> None:
        if self._last is not None:
            vertices, takes = torch.cat([self._last[0], vertices]), torch.cat([self._last[1], takes])
        second = torch.linalg.norm(vertices.diff(n=2, dim=0), dim=-1)
        second = second[takes[2:] == takes[:-2]]
        if len(second):
            jumps = second.amax(dim=1) - torch.quantile(second, 0.9, dim=1) > SNAP
            self.frames.update(
                count=len(second), jitter=float(second.mean(dim=1).double().sum()), snaps=int(jumps.sum())
            )
        self._last = vertices[-2:], takes[-2:]

    def include(self, other: Figures) -> None:
        """Count in all that `other` has counted, of the same garment."""
        self.sums.update(other.sums)
        self.frames.update(other.frames)
        self.depths += other.depths
        self.samples += other.samples

    def result(self) -> dict[str, float]:
        """Means over `pairs` samples.

        Depths in mm: the deepest of all, and the 99.9th percentile of each sample's deepest. With takes also
        `jitter_mm`, the mean second difference of vertex positions from frame to frame, and `snaps_percent` of frames.
        """
        depths = 1000 * torch.cat(self.depths)
        figures = {name: value / self.samples for name, value in self.sums.items()}
        figures["max_depth_mm"] = float(depths.max())
        figures["max_depth_p999_mm"] = float(torch.quantile(depths, 0.999))
        figures["energy_j"] = figures["stretch_j"] + figures["bend_j"] + figures["collision_j"]
        if frames := self.frames["count"]:
            figures["jitter_mm"] = 1000 * self.frames["jitter"] / frames
            figures["snaps_percent"] = 100 * self.frames["snaps"] / frames
        return figures | {"pairs": self.samples}
