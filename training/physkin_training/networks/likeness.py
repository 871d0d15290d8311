"""How much one garment is like another: by how far their cloth is apart, both ways, and by their openings."""

from __future__ import annotations

from dataclasses import dataclass

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.surface_paths import openings
from physkin_training.networks.carried_model import Counterparts

__all__ = ["NEAR", "Likeness"]

BEYOND = 0.05
"""[m] Cloth farther than this from all of another garment's has no counterpart there."""
MOST_BEYOND = 0.4
"""Share of its cloth that may have none where it begins with that garment's networks."""
NEAR = f"at most {100 * MOST_BEYOND:.0f} % of the cloth farther than {1e3 * BEYOND:.0f} mm from a shipped one's"
OTHER_OPENINGS = 0.02
"""[m] of distance that one opening more or less counts as: a skirt is not a pair of trousers."""
NOT_COVERED = 0.3
"""What the other garment's distance from the new one counts, against the new one's from it: cloth too much is left
out."""


@dataclass(frozen=True)
class Likeness:
    """How far a garment's cloth is from that of `model`: mean and farthest [m], `beyond`, the share of it without a
    counterpart, and how many openings more or fewer it has. score [m]: the lower, the more alike."""

    model: GarmentModel
    mean: float
    farthest: float
    beyond: float
    openings: int
    score: float

    @classmethod
    def between(cls, garment: Garment, model: GarmentModel) -> Likeness:
        """How a garment is like that of a model."""
        other = model.garment
        there, back = Counterparts.of(garment, other).distance, Counterparts.of(other, garment).distance
        area, other_area = (each.vertex_areas / each.vertex_areas.sum() for each in (garment, other))
        mean = float(there @ area)
        more = len(openings(garment.vertices, garment.faces)) - len(openings(other.vertices, other.faces))
        score = mean + NOT_COVERED * float(back @ other_area) + OTHER_OPENINGS * abs(more)
        return cls(model, mean, float(there.max()), float(area[there > BEYOND].sum()), more, score)

    @property
    def near(self) -> bool:
        """Whether it is a start at all."""
        return self.beyond <= MOST_BEYOND

    def __str__(self) -> str:
        opening = f", {abs(self.openings)} openings {'more' if self.openings > 0 else 'fewer'}" if self.openings else ""
        return (
            f"{self.model.name}: {1e3 * self.mean:.0f} mm away on average, {1e3 * self.farthest:.0f} mm at most, "
            f"{100 * self.beyond:.0f} % of the cloth beyond it{opening}"
        )
