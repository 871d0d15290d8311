"""How one garment sits on one avatar, at rest and in everyday poses, and a verdict.

Dimensions: `P` poses, `d` degrees of freedom. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from physkin_core.check.rest_check import RestCheck, rest_check
from physkin_core.outfit.draper import Draper
from physkin_core.quality import contact_figures, edge_strain, signed_distance

__all__ = ["GarmentCheck", "Verdict", "check_garment"]

GOOD_EVERYDAY = 1.0
"""Most of the vertices inside the body [%], over the everyday poses, for the verdict "good"."""

Verdict = Literal["good", "usable", "bad"]


@dataclass(frozen=True)
class Everyday:
    """Over the everyday poses: mean share of the vertices inside the body, the deepest of all, mean edge strain against
    the rest shape worn."""

    inside_percent: float
    deepest_mm: float
    edge_strain_percent: float


@dataclass(frozen=True)
class GarmentCheck:
    """What was found."""

    rest: RestCheck
    everyday: Everyday

    @property
    def verdict(self) -> Verdict:
        """ "bad" where it sits badly at rest; "good" where it sits well and everyday poses have at most 1 % inside."""
        if self.rest.sits_badly:
            return "bad"
        return "good" if self.rest.sits_well and self.everyday.inside_percent <= GOOD_EVERYDAY else "usable"

    def __str__(self) -> str:
        everyday = self.everyday
        return (
            f"{self.verdict}: {self.rest}; in everyday poses {everyday.inside_percent:.2f} % is inside, "
            f"{everyday.deepest_mm:.0f} mm deep"
        )

    def as_plain_data(self) -> dict:
        """For JSON: `rest` and `everyday` with their figures, `skin_shows_percent` (at rest) and `verdict`."""
        rest = asdict(self.rest)
        shows = rest.pop("skin_shows_percent")
        return {"rest": rest, "everyday": asdict(self.everyday), "skin_shows_percent": shows, "verdict": self.verdict}


def check_garment(draper: Draper, poses: Sequence[tuple[np.ndarray, np.ndarray]]) -> GarmentCheck:
    """Look at a garment on its avatar, at rest and in poses (joint positions (d,) [rad], direction of gravity (3,)),
    everyday ones: a second or two."""
    avatar, rig = draper.avatar, draper.model.rig
    at_rest = rest_check(draper.model.garment, draper.drape(rig.rest)[:, :3], avatar.vertices, avatar.faces)
    distances, strains = [], []
    for positions, gravity in poses:
        cloth = draper.drape(positions, gravity)[:, :3]
        body = avatar.posed_vertices(draper.bone_transforms(positions))
        distances.append(signed_distance(cloth, body, avatar.faces))
        strains.append(edge_strain(draper.rest_garment, cloth))
    contact = contact_figures(np.array(distances))
    everyday = Everyday(
        inside_percent=contact["inside_percent"],
        deepest_mm=contact["max_depth_mm"],
        edge_strain_percent=float(np.mean(strains)),
    )
    return GarmentCheck(at_rest, everyday)
