"""How much one garment is like another: by how far their cloth is apart, both ways, and by their openings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.surface_paths import openings
from physkin_training.transfer.matched_folds import BEYOND, Counterparts

__all__ = ["NEAR", "Likeness"]

MOST_BEYOND, FARTHEST = 0.4, 0.4
"""Share of its cloth that may have none, and how far [m] that may be, where it begins with that garment's networks."""
NEAR = (
    f"at most {100 * MOST_BEYOND:.0f} % of the cloth farther than {1e3 * BEYOND:.0f} mm from a shipped one's, none "
    f"farther than {1e3 * FARTHEST:.0f} mm"
)
OTHER_OPENINGS = 0.02
"""[m] of distance that one opening more or less counts as: a skirt is not a pair of trousers."""
NOT_COVERED = 0.1
"""What the other garment's distance from the new one counts, against the new one's from it: cloth too much is left
out."""


@dataclass(frozen=True)
class Likeness:
    """How far a garment's cloth is from that of `model`: mean and farthest [m], `beyond`, the share of it without a
    counterpart, and how many openings more or fewer it has. score [m]: the lower, the more
    alike; cloth without a counterpart counts the same however far it is, as it goes on as the edge there does."""

    model: GarmentModel
    mean: float
    farthest: float
    beyond: float
    openings: int
    score: float

    @classmethod
    def nearest(cls, garment: Garment, models: Iterable[GarmentModel]) -> Likeness:
        """How a garment is like that of the model which it is most like."""
        loops = len(openings(garment.vertices, garment.faces))
        return min((cls._between(garment, loops, model) for model in models), key=lambda each: each.score)

    @classmethod
    def _between(cls, garment: Garment, loops: int, model: GarmentModel) -> Likeness:
        other = model.garment
        there, back = Counterparts.of(garment, other).distance, Counterparts.of(other, garment).distance
        area, other_area = (each.vertex_areas / each.vertex_areas.sum() for each in (garment, other))
        mean = float(there @ area)
        more = loops - len(openings(other.vertices, other.faces))
        capped, capped_back = (float(np.minimum(d, BEYOND) @ a) for d, a in ((there, area), (back, other_area)))
        score = capped + NOT_COVERED * capped_back + OTHER_OPENINGS * abs(more)
        return cls(model, mean, float(there.max()), float(area[there > BEYOND].sum()), more, score)

    @property
    def near(self) -> bool:
        """Whether it is a start at all."""
        return self.beyond <= MOST_BEYOND and self.farthest <= FARTHEST

    def __str__(self) -> str:
        opening = f", {abs(self.openings)} openings {'more' if self.openings > 0 else 'fewer'}" if self.openings else ""
        return (
            f"{self.model.name}: {1e3 * self.mean:.0f} mm away on average, {1e3 * self.farthest:.0f} mm at most, "
            f"{100 * self.beyond:.0f} % of the cloth beyond it{opening}"
        )
