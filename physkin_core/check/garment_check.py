"""How one garment sits on one avatar, at rest and in everyday poses, and a verdict.

At rest: what of the cloth is inside the body, what of the skin shows, and whether collar or waistband stands off.
Dimensions: `P` poses, `d` degrees of freedom, `n` garment vertices, `V` body vertices, `f` body faces. Metres.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal, get_args

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.check.sight import stands_off_mm
from physkin_core.model.garment import Garment, face_areas
from physkin_core.model.surface_paths import mesh_edges, path_lengths
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.quality import contact_figures, edge_strain, signed_distance
from physkin_core.runtime.layer import Layer
from physkin_core.sway.frame_input import UPRIGHT_GRAVITY

__all__ = [
    "VERDICTS",
    "GarmentCheck",
    "RestCheck",
    "SkinSeen",
    "Verdict",
    "check_garment",
    "near_hem",
    "rest_check",
    "skin_seen",
    "skin_without_cloth",
]

REACH = 0.1
"""Skin belongs to the cloth that its normal meets within this distance [m], on either side."""
FROM_HEM = 0.03
"""Skin under cloth this close [m] to a hem may show."""
SKIN_SPACING = 1e-4
"""Rays start this far [m] off the skin."""
CLEAR_PERCENT = 0.05
"""Most of the vertices [%] that may be inside where a garment sits well."""
BAD_PERCENT, BAD_DEPTH_MM = 2.0, 20.0
"""More of the vertices inside, or one deeper, is bad."""
SHOWN_PERCENT = 0.005
"""Less of the skin than this is none: a face or two."""
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
    see `skin_without_cloth`."""

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
    """The garment draped at the canonical pose, cloth (n, 3), on a body (V, 3), (f, 3); some tens of milliseconds."""
    contact = contact_figures(signed_distance(cloth, body_vertices, body_faces))
    return RestCheck(
        inside_percent=contact["inside_percent"],
        deepest_mm=contact["max_depth_mm"],
        skin_shows_percent=skin_without_cloth(garment, cloth, body_vertices, body_faces),
    )


@dataclass(frozen=True)
class SkinSeen:
    """Faces of the body, (f,) bool. belongs: that have cloth above or beneath; shows: of these, with none above."""

    belongs: np.ndarray
    shows: np.ndarray

    def shows_percent(self, areas: np.ndarray) -> float:
        """Share [%] of the skin that belongs to the cloth. areas: (f,) of the body's faces."""
        return float(100 * areas[self.shows].sum() / max(areas[self.belongs].sum(), 1e-12))


def skin_without_cloth(garment: Garment, cloth: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> float:
    """Of the skin that has cloth above or beneath it, the share [%] that has none above.

    cloth: (n, 3) [m] the garment's vertices; body_vertices (V, 3), body_faces (f, 3).
    """
    seen = skin_seen(cloth, garment.faces, near_hem(garment), body_vertices, body_faces)
    return seen.shows_percent(face_areas(np.asarray(body_vertices, dtype=np.float64), body_faces))


def skin_seen(
    cloth: np.ndarray, cloth_faces: np.ndarray, hem: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray
) -> SkinSeen:
    """Which skin shows through cloth (n, 3) [m], of one garment or of several together, with faces cloth_faces (g, 3).

    hem: (n,) bool, from `near_hem`: skin whose nearest cloth along the normal is there counts as covered.
    body_vertices (V, 3), body_faces (f, 3).
    """
    from point_cloud_utils import ray_mesh_intersection

    cloth = np.ascontiguousarray(cloth, dtype=np.float64)
    faces = np.ascontiguousarray(cloth_faces, dtype=np.int64)
    corners = np.asarray(body_vertices, dtype=np.float64)[body_faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    centres = corners.mean(axis=1)
    cloth_normals = np.cross(cloth[faces[:, 1]] - cloth[faces[:, 0]], cloth[faces[:, 2]] - cloth[faces[:, 0]])

    def meets(way: np.ndarray, start: float) -> np.ndarray:
        """The cloth's face (f,) that a ray meets first, which looks as the skin does; -1 for none."""
        origins = np.ascontiguousarray(centres + start * normals)
        hit, _, distance = ray_mesh_intersection(cloth, faces, origins, np.ascontiguousarray(way))
        found = (hit >= 0) & np.isfinite(distance) & (distance < REACH)
        alike = (cloth_normals[np.where(found, hit, 0)] * normals).sum(axis=1) > 0
        return np.where(found & alike, hit, -1)

    above, beneath = meets(normals, SKIN_SPACING), meets(-normals, SKIN_SPACING)
    shows = (above < 0) & (beneath >= 0) & ~hem[faces].any(axis=1)[np.maximum(beneath, 0)]
    return SkinSeen(belongs=(above >= 0) | shows, shows=shows)


def near_hem(garment: Garment) -> np.ndarray:
    """(n,) bool, vertices within 3 cm of an edge that only one face has, along the mesh at rest."""
    edges, count = mesh_edges(garment.faces)
    return path_lengths(garment.vertices, garment.faces, np.unique(edges[count == 1])) <= FROM_HEM


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
    distances, strains = [], []
    for pose, cloth in zip(positions, layer.drape(zip(positions, downs))):
        body = avatar.posed_vertices(rig.bone_transforms(pose, heads=avatar.bone_heads))
        distances.append(signed_distance(cloth[:, :3], body, avatar.faces))
        strains.append(edge_strain(layer.rest_garment, cloth[:, :3]))
    contact = contact_figures(np.array(distances))
    everyday = Everyday(
        inside_percent=contact["inside_percent"],
        deepest_mm=contact["max_depth_mm"],
        edge_strain_percent=float(np.mean(strains)),
    )
    return GarmentCheck(at_rest, everyday, stands_off_mm(layer, lying, avatar.vertices, avatar.faces))
