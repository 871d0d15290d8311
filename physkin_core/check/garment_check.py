"""How one garment sits on one avatar, at rest and in everyday poses, and a verdict.

At rest: what of the cloth is inside the body, what of the skin shows, and whether collar or waistband stands off.
Dimensions: `P` poses, `d` degrees of freedom, `n` garment vertices, `V` body vertices, `f` body faces. Metres.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal, get_args

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.check.sight import Surface, skin_shows
from physkin_core.check.thinned_body import thinned
from physkin_core.model.garment import Garment
from physkin_core.model.surface_paths import hem_distances, openings
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.quality import contact_figures, edge_strain, signed_distance
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_core.runtime.layer import Layer

__all__ = ["VERDICTS", "GarmentCheck", "RestCheck", "Verdict", "check_garment", "rest_check", "stands_off_mm"]

MOSTLY = 90
"""Percentile of an opening's distances that counts: a waistband may stand off at the back alone."""
CLEAR_PERCENT = 0.05
"""Most of the vertices [%] that may be inside where a garment sits well."""
BAD_PERCENT, BAD_DEPTH_MM = 2.0, 20.0
"""More of the vertices inside, or one deeper, is bad."""
SHOWN_PERCENT = 0.005
"""Less of the pixels than this is none."""
GOOD_EVERYDAY = 1.0
"""Most of the vertices inside the body [%], over the everyday poses, for the verdict "good"."""
STANDS_OFF_MM, GAPES_MM = 15.0, 40.0
"""From here on a collar or waistband that is so much farther from the skin than it was made is not good, and bad."""

Verdict = Literal["good", "usable", "bad"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
"""From best to worst."""


@dataclass(frozen=True)
class RestCheck:
    """inside_percent: of the garment's vertices inside the body. deepest_mm: the deepest of them. skin_shows_percent:
    of the pixels that should show cloth those that show skin, see `skin_shows`."""

    inside_percent: float
    deepest_mm: float
    skin_shows_percent: float

    @property
    def sits_well(self) -> bool:
        """At most 0.05 % inside, and no skin shows."""
        return self.inside_percent <= CLEAR_PERCENT and self.skin_shows_percent < SHOWN_PERCENT

    @property
    def sits_badly(self) -> bool:
        """More than 2 % inside, or deeper than 20 mm."""
        return self.inside_percent > BAD_PERCENT or self.deepest_mm > BAD_DEPTH_MM

    def __str__(self) -> str:
        return (
            f"{self.inside_percent:.2f} % of the cloth is inside the body at rest, {self.deepest_mm:.0f} mm deep, and "
            f"{self.skin_shows_percent:.2f} % of the skin shows"
        )


def rest_check(garment: Garment, cloth: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> RestCheck:
    """The garment draped at the canonical pose, cloth (n, 3), on a body (V, 3), (f, 3); some tenths of a second."""
    contact = contact_figures(signed_distance(cloth, body_vertices, body_faces))
    hem_distance = hem_distances(garment.vertices, garment.faces)
    shown = skin_shows(Surface(body_vertices, body_faces), Surface(cloth, garment.faces, hem_distance))
    return RestCheck(
        inside_percent=contact["inside_percent"],
        deepest_mm=contact["max_depth_mm"],
        skin_shows_percent=shown.percent,
    )


@dataclass(frozen=True)
class Everyday:
    """Over the everyday poses: mean share of the vertices inside the body, the deepest of all, mean edge strain against
    the rest shape worn."""

    inside_percent: float
    deepest_mm: float
    edge_strain_percent: float


@dataclass(frozen=True)
class GarmentCheck:
    """What was found. stands_off_mm: as of the function."""

    rest: RestCheck
    everyday: Everyday
    stands_off_mm: float = 0.0

    @property
    def stands_off(self) -> bool:
        """By 15 mm or more."""
        return self.stands_off_mm >= STANDS_OFF_MM

    @property
    def verdict(self) -> Verdict:
        """ "bad" where it sits badly at rest or stands off by 40 mm; "good" where it sits well, stands off by less than
        15 mm, and everyday poses have at most 1 % inside."""
        if self.rest.sits_badly or self.stands_off_mm >= GAPES_MM:
            return "bad"
        well = self.rest.sits_well and not self.stands_off
        return "good" if well and self.everyday.inside_percent <= GOOD_EVERYDAY else "usable"

    def __str__(self) -> str:
        everyday = self.everyday
        return (
            f"{self.verdict}: {self.rest}; in everyday poses {everyday.inside_percent:.2f} % is inside, "
            f"{everyday.deepest_mm:.0f} mm deep; the upper opening stands off by {self.stands_off_mm:.0f} mm"
        )

    def as_plain_data(self) -> dict:
        """For JSON: `rest` and `everyday` with their figures, `skin_shows_percent` and `stands_off_mm` (at rest) and
        `verdict`."""
        rest = asdict(self.rest)
        shows = rest.pop("skin_shows_percent")
        figures = {"rest": rest, "everyday": asdict(self.everyday), "skin_shows_percent": shows}
        return {**figures, "stands_off_mm": self.stands_off_mm, "verdict": self.verdict}


def check_garment(layer: Layer, avatar: Avatar, *, poses: np.ndarray | None = None) -> GarmentCheck:
    """Look at a garment as it is worn on an avatar, at rest and in everyday poses: a second or two.

    poses: (P, d) [rad] joint positions in place of the everyday ones, as where limbs have been separated.
    """
    rig = layer.model.rig
    (lying,) = layer.drape([(rig.rest, UPRIGHT_GRAVITY)])
    lying = lying[:, :3]
    at_rest = rest_check(layer.model.garment, lying, avatar.vertices, avatar.faces)
    usual, downs = everyday_poses(rig)
    positions = usual if poses is None else poses
    posed, distances, strains = thinned(avatar), [], []
    for pose, cloth in zip(positions, layer.drape(zip(positions, downs))):
        body = posed.posed_vertices(rig.bone_transforms(pose, heads=avatar.bone_heads))
        distances.append(signed_distance(cloth[:, :3], body, posed.faces))
        strains.append(edge_strain(layer.rest_garment, cloth[:, :3]))
    contact = contact_figures(np.array(distances))
    everyday = Everyday(
        inside_percent=contact["inside_percent"],
        deepest_mm=contact["max_depth_mm"],
        edge_strain_percent=float(np.mean(strains)),
    )
    return GarmentCheck(at_rest, everyday, stands_off_mm(layer, lying, avatar.vertices, avatar.faces))


def stands_off_mm(layer: Layer, cloth: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> float:
    """How much farther [mm] than on the body that it was made on the uppermost opening of a garment, collar or
    waistband, is from the skin. cloth: (n, 3) at rest, on a body (V, 3), (f, 3)."""
    garment, maker = layer.model.garment, load_body_model()
    loops = openings(garment.vertices, garment.faces)
    if not loops or layer.model.rig.bone_names != maker.rig.bone_names:
        return 0.0
    made_on = maker.vertices(maker.garment_body)
    usual = signed_distance(garment.vertices[loops[0]], made_on, maker.faces)
    here = signed_distance(cloth[loops[0]], body_vertices, body_faces)
    return 1000 * max(float(np.percentile(here, MOSTLY) - np.percentile(usual, MOSTLY)), 0.0)
