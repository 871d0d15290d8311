"""Verdicts on a garment mesh, and the mesh as the checks have repaired it so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh

__all__ = ["COLUMNS", "Checks", "Outcome", "Verdict", "in_lines"]

Outcome = Literal["ok", "repaired", "warning", "unsure", "refused"]
COLUMNS = ("check", "verdict", "found", "allowed")


@dataclass(frozen=True)
class Verdict:
    """One check: its name, outcome, what was found and what is allowed, in plain words."""

    check: str
    outcome: Outcome
    found: str
    allowed: str


class Checks:
    """vertices (n, 3) and faces (f, 3) as repaired so far, and the verdicts. lines: (k, 2, 3), ends of line elements
    that lie on the mesh, until it is taken from where it was made."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, lines: np.ndarray) -> None:
        self.vertices, self.faces, self.lines = vertices, faces, lines
        self.verdicts: list[Verdict] = []

    def say(self, check: str, outcome: Outcome, found: str, allowed: str) -> None:
        """Add a verdict."""
        self.verdicts.append(Verdict(check, outcome, found, allowed))

    @property
    def refused(self) -> bool:
        """Whether the last verdict ends the checks."""
        return bool(self.verdicts) and self.verdicts[-1].outcome == "refused"

    @property
    def unsure(self) -> bool:
        """Whether something was found that only the user can tell to be right."""
        return any(verdict.outcome == "unsure" for verdict in self.verdicts)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """What is so far, for its areas, normals and edges."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)


def in_lines(verdicts: Sequence[Verdict]) -> str:
    """Verdicts as lines of text: each that is not ok, then the names of those that are."""
    lines = [
        f"{each.outcome}: {each.check}: {each.found} (allowed: {each.allowed})"
        for each in verdicts
        if each.outcome != "ok"
    ]
    ok = [each.check for each in verdicts if each.outcome == "ok"]
    return "\n".join([*lines, f"ok: {', '.join(ok) or 'none'}"])
