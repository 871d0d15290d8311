"""Why an outfit is not good on an avatar, by what stands out most, and what its user can do about it, if anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from physkin_core.avatar.body_model import ADULT_STATURE
from physkin_core.check.garment_check import VERDICTS, GarmentCheck, Verdict
from physkin_core.check.likeness import Likeness

__all__ = ["OutfitCheck", "reason_and_advice"]

HOLE_PERCENT, WIDE_HOLE_PERCENT = 0.1, 1.0
"""From here on holes are not good, and bad."""
FAR_PIVOT_MM, FAR_SKIN_MM, FAR_SHAPE, FAR_LENGTH = 40.0, 10.0, 2.0, 1.25
USUAL_HEIGHT, KNOWN_HEIGHTS = 1.7, (0.9, 2.1)
"""[m] Garments were made for bodies within the second: children of three years are as small."""
MUCH_OVERLAP = 5.0
"""From here on a figure is what the reason is about."""


@dataclass(frozen=True)
class OutfitCheck:
    """What was found. garments: by name. hole_percent: of `hole_percent`. overlap_percent: of `body_overlap`.
    measured: whether all garments are made to measure. limbs_apart: whether limbs were separated. undressed: whether
    clothes that the avatar wears already are not shown. bare: as of `bare_parts`.
    height: of the body at rest [m]."""

    garments: Mapping[str, GarmentCheck]
    known: Likeness
    hole_percent: float = 0.0
    overlap_percent: float = 0.0
    measured: bool = True
    limbs_apart: bool = False
    undressed: bool = False
    bare: tuple[str, ...] = ()
    height: float = USUAL_HEIGHT

    @property
    def verdict(self) -> Verdict:
        """The worst garment's, or that of the holes where these are worse."""
        holes: Verdict = "good" if self.hole_percent < HOLE_PERCENT else "usable"
        holes = "bad" if self.hole_percent >= WIDE_HOLE_PERCENT else holes
        return max(holes, *(check.verdict for check in self.garments.values()), key=VERDICTS.index)


def reason_and_advice(found: OutfitCheck) -> tuple[str, str]:
    """Why the verdict is not "good", and what to do; each a sentence, or empty where there is nothing to say."""
    if found.verdict == "good":
        return "", "Wear it."
    name, worst = max(found.garments.items(), key=lambda item: VERDICTS.index(item[1].verdict))
    if found.bare:
        return f"The body has no skin on {', '.join(found.bare)}.", "Wear what does not cover that."
    if found.hole_percent >= HOLE_PERCENT:
        share = f"{found.hole_percent:.1f} % of what one sees is the inside of the body: its skin has holes."
        if found.undressed:
            return share, "Keep its own clothes: --own-clothes keep."
        return share, "Close the skin in a modelling tool, or wear what covers it."
    if worst.stands_off:
        gap = f"The upper opening of {name} stands off by {worst.stands_off_mm:.0f} mm."
        return gap, "" if found.measured else "Wear it made to measure: --fit 1."
    if found.overlap_percent > MUCH_OVERLAP and not found.limbs_apart:
        overlap = f"In everyday poses {found.overlap_percent:.0f} % of the skin is inside the body."
        return overlap, "Move arms and legs out of it: --separate-limbs."
    low, high = KNOWN_HEIGHTS
    if not low <= found.height <= high:
        return f"The body is {found.height:.2f} m tall, and garments were made for {low} to {high} m.", ""
    if found.height < ADULT_STATURE and not found.measured:
        one_size = f"The body is a child's, {found.height:.2f} m tall, and garments in one size are an adult's."
        return one_size, "Wear it made to measure: --fit 1."
    return _cause(found.known) or _where(worst), ""


def _cause(known: Likeness) -> str:
    """What about the avatar makes cloth sit badly; nobody who wears it can change that."""
    if known.pivot_distance_mm > FAR_PIVOT_MM:
        where = f"{known.pivot_distance_mm:.0f} mm from where bodies have it"
        return f"The joint {known.pivot_bone} lies {where}, and cloth turns about it."
    if not 1 / FAR_LENGTH < known.longest_ratio < FAR_LENGTH:
        return f"{known.longest_bone} is {known.longest_ratio:.2f} times as long as on known bodies."
    if known.shape_deviation > FAR_SHAPE or known.skin_distance_mm > FAR_SKIN_MM:
        apart = f"{known.shape_deviation:.1f} standard deviations and {known.skin_distance_mm:.0f} mm"
        return f"The body is {apart} from known bodies."
    return ""


def _where(worst: GarmentCheck) -> str:
    if worst.rest.sits_well:
        return "Cloth is under the skin in some poses only."
    return "Some cloth is under the skin at rest; pictures and exported files leave that skin out."
