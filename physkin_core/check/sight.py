"""What one sees of a dressed figure and should not see: skin or an inner layer where cloth covers it, and holes.

Twelve cameras around a figure, above and below, look at it along parallel lines of sight, one a pixel. What lies next
to the outside of an outer surface at rest, beneath it or, where that has sunk in, above it, belongs under it. It shows
in a pose where it is the first thing seen and outside of the outer surface: what one sees through an opening is inside.
Nothing shows where the closest cloth is a hem: hems are lifted.

A line of sight that meets an edge between two faces may pass between them, and which of them it meets differs from one
processor to another. So a pixel counts only in a square of two by two that agree, and no camera stands in the plane of
symmetry of bodies, in which many of their edges lie.

Dimensions: `n` vertices, `f` faces, `R` lines of sight, `k` some of them. Metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import binary_opening

from physkin_core.avatar.body_parts import free_bones
from physkin_core.model.surface_paths import HEM
from physkin_core.outfit.outfit import Outfit
from physkin_core.quality import closest_points, signed_distance

__all__ = [
    "Cameras",
    "Cover",
    "Figure",
    "Shown",
    "Surface",
    "hole_percent",
    "holes",
    "skin_shows",
    "what_shows",
    "who_covers",
]

CAMERAS, FIRST_AZIMUTH, ELEVATIONS = 12, 7.0, (20.0, 0.0, -20.0)
"""Around a figure; angles [degrees], elevations in turn: into collars, straight, under hems."""
PIXELS_HIGH = 160
"""Pixels over the height of what is looked at, and as wide ones beside each other."""
FAR = 10.0
"""[m] Farther than any body is large."""
REACH = 0.1
"""[m] Surfaces that belong over each other lie this closely at rest."""
BEYOND = 1e-4
"""[m] behind a surface the next one is looked for."""
OUTLINE = 0.012
"""[m] What is left out makes the outline of what is over it slimmer by up to this, which is no hole."""


@dataclass(frozen=True)
class Surface:
    """vertices: (n, 3). faces: (f, 3), facing outwards. hem_distance: (n,) along cloth to its closest opening; None of
    skin, which has no hem."""

    vertices: np.ndarray
    faces: np.ndarray
    hem_distance: np.ndarray | None = None


class Cameras:
    """Lines of sight of all cameras onto the box about vertices (n, 3).

    origins, directions: (R, 3), of unit length. pixel: [m] its width and height.
    """

    def __init__(self, vertices: np.ndarray) -> None:
        vertices = vertices.astype(np.float64)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        centre, self.pixel = (low + high) / 2, (high - low)[2] / PIXELS_HIGH
        origins, directions, self._sizes = [], [], []
        for camera in range(CAMERAS):
            azimuth = np.radians(FIRST_AZIMUTH + 360 * camera / CAMERAS)
            elevation = np.radians(ELEVATIONS[camera % len(ELEVATIONS)])
            right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
            ahead = -np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * np.cos(elevation)
            ahead[2] = -np.sin(elevation)
            axes = np.stack([right, np.cross(right, ahead)])
            seen = (vertices - centre) @ axes.T
            across, along = (np.arange(a, b, self.pixel) for a, b in zip(seen.min(axis=0), seen.max(axis=0)))
            grid = np.stack(np.meshgrid(across, along), axis=-1).reshape(-1, 2) @ axes
            origins.append(centre + grid - FAR / 2 * ahead)
            directions.append(np.broadcast_to(ahead, grid.shape))
            self._sizes.append((len(along), len(across)))
        self.origins, self.directions = np.concatenate(origins), np.concatenate(directions)

    def agreed(self, seen: np.ndarray, pixels: int = 2) -> np.ndarray:
        """Of pixels (R,) bool those in a square of so many that are all seen."""
        ends = np.cumsum([height * width for height, width in self._sizes])[:-1]
        images = (each.reshape(size) for each, size in zip(np.split(seen, ends), self._sizes))
        return np.concatenate([binary_opening(image, np.ones((pixels, pixels))).reshape(-1) for image in images])


@dataclass(frozen=True)
class Hits:
    """What each of k lines of sight meets next. surface: (k,) its index, -1 for none. face: (k,) of that surface.
    distance: (k,) from where it began. facing: (k,) bool, the outside is seen."""

    surface: np.ndarray
    face: np.ndarray
    distance: np.ndarray
    facing: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> Hits:
        return Hits(*(getattr(self, entry.name)[chosen] for entry in fields(self)))

    def on(self, surface: int, faces: np.ndarray) -> np.ndarray:
        """(k,) bool: the outside of those of a surface's faces (f,) bool is met."""
        met = (self.surface == surface) & self.facing
        met[met] = faces[self.face[met]]
        return met


class Figure:
    """Surfaces from the skin outwards, and what is seen of them. cameras: default those onto all of them."""

    def __init__(self, surfaces: Sequence[Surface], cameras: Cameras | None = None) -> None:
        from point_cloud_utils import RayMeshIntersector

        self.surfaces = surfaces
        first = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
        self._starts = np.cumsum([0, *(len(surface.faces) for surface in surfaces)])
        vertices = np.concatenate([surface.vertices for surface in surfaces]).astype(np.float64)
        faces = np.concatenate([surface.faces + start for surface, start in zip(surfaces, first)]).astype(np.int64)
        a, b, c = vertices[faces].transpose(1, 0, 2)
        self._normals = np.cross(b - a, c - a)
        self._mesh = RayMeshIntersector(vertices, faces)
        self.cameras = cameras or Cameras(vertices)
        self.first = self.meet(self.cameras.origins, self.cameras.directions)
        """What is seen, (R,)."""

    def meet(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """What lines of sight (k, 3) meet first."""
        count = len(origins)
        if count == 1:  # the library reads the arrays in another order then
            origins, directions = np.repeat(origins, 2, axis=0), np.repeat(directions, 2, axis=0)
        found = self._mesh.intersect_rays(np.ascontiguousarray(origins), np.ascontiguousarray(directions))
        face, _, distance = (x[:count] for x in found)
        met = (face >= 0) & np.isfinite(distance)
        face = np.where(met, face, 0).astype(np.int64)
        surface = np.searchsorted(self._starts, face, side="right") - 1
        facing = met & (np.einsum("ki,ki->k", self._normals[face], directions[:count]) < 0)
        within = face - self._starts[surface]
        return Hits(np.where(met, surface, -1), within, np.where(met, distance, np.inf), facing)

    def seen_points(self, pixels: np.ndarray) -> np.ndarray:
        """(k, 3) where what is seen in pixels (k,) is."""
        away = self.first.distance[pixels, None]
        return self.cameras.origins[pixels] + away * self.cameras.directions[pixels]

    def behind(self, pixels: np.ndarray) -> Hits:
        """What lies behind what is seen in pixels (k,); distances are from there."""
        directions = self.cameras.directions[pixels]
        return self.meet(self.seen_points(pixels) + BEYOND * directions, directions)


@dataclass(frozen=True)
class Cover:
    """Which faces of an inner surface belong under an outer one, (f,) bool, and which of the outer one over it."""

    under: np.ndarray
    over: np.ndarray


def who_covers(inner: Surface, outer: Surface) -> Cover:
    """What belongs under an outer surface at rest: next to its outside within 10 cm, facing as it does."""
    return _cover(Figure([inner, outer], Cameras(outer.vertices)))


def _cover(figure: Figure) -> Cover:
    """Of a figure of two surfaces."""
    pixels = np.flatnonzero(figure.first.facing)
    first, second = figure.first[pixels], figure.behind(pixels)
    both = second.facing & (second.surface != first.surface) & (second.distance < REACH)
    marked = []
    for index, surface in enumerate(figure.surfaces):
        corner = np.zeros(len(surface.vertices), dtype=bool)
        for hits in (first, second):
            corner[surface.faces[hits.face[both & (hits.surface == index)]]] = True
        marked.append(corner[surface.faces].all(axis=1))
    return Cover(*marked)


@dataclass(frozen=True)
class Shown:
    """What shows of an inner surface. pixels: of all cameras, in which the outer one is or should be. shows: of these,
    in which the inner one is. faces: (f,) bool, its faces there."""

    pixels: int
    shows: int
    faces: np.ndarray

    @property
    def percent(self) -> float:
        """Of the pixels in which the outer surface should be."""
        return 100 * self.shows / max(self.pixels, 1)


def what_shows(figure: Figure, covers: Mapping[tuple[int, int], Cover]) -> dict[tuple[int, int], Shown]:
    """What shows in a pose of each pair of an inner and an outer surface, indices into the figure's."""
    found = {}
    for (inner, outer), cover in covers.items():
        shows = figure.first.on(inner, cover.under)
        shows[shows] = _outside(figure.seen_points(np.flatnonzero(shows)), figure.surfaces[outer])
        shows = figure.cameras.agreed(shows)
        faces = np.zeros(len(cover.under), dtype=bool)
        faces[figure.first.face[shows]] = True
        covered = figure.first.on(outer, cover.over)
        found[inner, outer] = Shown(int((covered | shows).sum()), int(shows.sum()), faces)
    return found


def skin_shows(skin: Surface, cloth: Surface) -> Shown:
    """What shows of the skin where cloth has sunk into it, in whatever pose both are."""
    figure = Figure([skin, cloth], Cameras(cloth.vertices))
    return what_shows(figure, {(0, 1): _cover(figure)})[0, 1]


def _outside(points: np.ndarray, outer: Surface) -> np.ndarray:
    """(k,) bool: points (k, 3) are outside of the closest cloth, and that is no hem."""
    if len(points) == 0:
        return np.zeros(0, dtype=bool)
    outside = signed_distance(points, outer.vertices, outer.faces) > 0
    if outer.hem_distance is None:
        return outside
    _, face, share = closest_points(points, outer.vertices, outer.faces)
    return outside & ((share * np.minimum(outer.hem_distance, FAR)[outer.faces[face]]).sum(axis=1) > HEM)


def holes(whole: Figure, given: Figure) -> np.ndarray:
    """(R,) bool, pixels of a figure of which some is left out: instead of the outside of cloth or skin, as of the whole
    figure, these show an inside, or nothing. Both are looked at by the same cameras."""
    wide = 2 + int(OUTLINE / given.cameras.pixel)
    return given.cameras.agreed(whole.first.facing & ~given.first.facing, wide)


def hole_percent(outfit: Outfit) -> float:
    """Of what is seen of a dressed figure at rest, the share [%] that is the inside of its body where skin is missing
    and no cloth is before it. Head, hands and feet do not count."""
    body, rest = outfit.body_to_draw, outfit.rig.rest
    surfaces = [Surface(outfit.posed_body(rest), body.faces)]
    surfaces += [Surface(cloth[:, :3], layer.faces) for cloth, layer in zip(outfit.drape(rest), outfit.layers)]
    figure = Figure(surfaces)
    seen = figure.first
    inside = (seen.surface == 0) & ~seen.facing
    skin = np.zeros(len(body.faces), dtype=bool)
    skin[: len(outfit.avatar.faces)] = ~_free_faces(outfit)
    inside[inside] = skin[seen.face[inside]]
    return float(100 * figure.cameras.agreed(inside).sum() / max((seen.surface >= 0).sum(), 1))


def _free_faces(outfit: Outfit) -> np.ndarray:
    """(f,) bool, the body's faces on head, hands and feet."""
    avatar = outfit.avatar
    strongest = avatar.influence_weights.argmax(axis=1)[:, None]
    bones = np.take_along_axis(avatar.influence_bones, strongest, axis=1)[:, 0]
    return free_bones(outfit.rig)[bones][avatar.faces].any(axis=1)
