"""Verdicts on a garment mesh, and the mesh as the checks have repaired it so far.

Dimensions: `n` vertices, `f` faces, `e` edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

__all__ = ["Checks", "Outcome", "Verdict", "verdict_table"]

Outcome = Literal["ok", "repaired", "warning", "refused"]


@dataclass(frozen=True)
class Verdict:
    """One check: its name, outcome, what was found and what is allowed, in plain words."""

    check: str
    outcome: Outcome
    found: str
    allowed: str


class Checks:
    """vertices (n, 3) and faces (f, 3) as repaired so far, and the verdicts."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = vertices, faces
        self.verdicts: list[Verdict] = []

    def say(self, check: str, outcome: Outcome, found: str, allowed: str) -> None:
        """Add a verdict."""
        self.verdicts.append(Verdict(check, outcome, found, allowed))

    @property
    def edges(self) -> np.ndarray:
        """Vertices (e, 2) of every edge."""
        return np.unique(np.sort(self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)

    @property
    def edge_mean(self) -> float:
        """Mean length of the edges."""
        ends = self.vertices[self.edges]
        return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())

    @property
    def areas(self) -> np.ndarray:
        """(f,)."""
        return np.linalg.norm(self._cross(), axis=1) / 2

    @property
    def normals(self) -> np.ndarray:
        """(f, 3) unit."""
        return self._cross() / (2 * self.areas[:, None])

    def _cross(self) -> np.ndarray:
        corners = self.vertices[self.faces]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def verdict_table(verdicts: tuple[Verdict, ...]) -> str:
    """The verdicts as a Markdown table."""
    lines = ["| check | verdict | found | allowed |", "|---|---|---|---|"]
    return "\n".join(lines + [f"| {v.check} | {v.outcome} | {v.found} | {v.allowed} |" for v in verdicts])
