"""What of an inner layer pokes through the one over it: how far, and what a viewer sees of it.

How far is measured to the closest point of the outer layer. What is seen is what eight cameras about an outfit show,
with parallel rays, one a pixel: of whole garments, inner cloth that shows through outer cloth; of what an outfit gives,
with the hidden cloth and skin left out, the holes that this leaves.

Dimensions: `n` vertices of a surface or of the inner layer, `r` of the outer layer, `f` faces, `k` points, `R` rays.
Metres, root frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_paths import mesh_edges, openings, path_lengths
from physkin_core.quality import closest_points, signed_distance

__all__ = ["CAMERAS", "HEM", "LayerPokes", "Surface", "View", "bind_layer_pokes", "camera_rays", "holes", "look"]

HEM = 0.03
"""Width [m] of the strip along the outer layer's openings that counts as hem: what lies under it may show."""
BELONGS = 0.15
"""[m] Cloth farther from the layer over it at rest is not under it."""
STANDS_OUT = 0.06
"""[m] What is farther outside in a pose is outside another part of the outer layer."""
CAMERAS = 8
"""About an outfit."""
ELEVATION = math.radians(8)
"""From how high cameras look down."""
PIXELS_HIGH = 160
"""Pixels over the height of what is looked at, and as wide ones beside each other."""
FAR = 10.0
"""[m] Farther than any body is large."""
BEHIND = 0.05
"""[m] Where cloth or skin that faces the camera lies this closely behind a surface left out, that is no hole."""
ON_EDGE = 0.05
"""Barycentric share up to which a point counts as on the opposite edge."""


@dataclass(frozen=True)
class LayerPokes:
    """Two layers, and where the one covers the other at rest.

    faces: of both, (f, 3). hem_distance: (r,) [m] along the outer layer to its closest opening. covered: (n,) bool,
    inner vertices that the outer layer covers at rest, away from its hem. covering: (r,) bool, outer ones over them.
    """

    faces: tuple[np.ndarray, np.ndarray]
    hem_distance: np.ndarray
    covered: np.ndarray
    covering: np.ndarray

    def depths(self, points: np.ndarray, normals: np.ndarray, outer: np.ndarray) -> np.ndarray:
        """How far points (k, 3) of the inner layer, with its normals (k, 3), stand out of the outer one (r, 3): (k,)
        [m]; 0 inside, where the outer layer's closest point is its hem or faces away, and from 6 cm on."""
        if len(points) == 0:
            return np.zeros(0)
        hem, alike = _closest(points, normals, outer, self.faces[1], self.hem_distance)
        outside = signed_distance(points, outer, self.faces[1])
        return np.where(alike & (hem > HEM) & (outside < STANDS_OUT), np.maximum(outside, 0), 0)


def bind_layer_pokes(inner: np.ndarray, outer: np.ndarray, faces: tuple[np.ndarray, np.ndarray]) -> LayerPokes:
    """Find what is covered. inner (n, 3) and outer (r, 3): whole layers at rest, as they are worn; faces (f, 3) of
    these, facing outwards."""
    own, over = (vertex_normals(vertices, of) for vertices, of in zip((inner, outer), faces))
    hems = path_lengths(outer, faces[1], np.concatenate([np.empty(0, dtype=int), *openings(outer, faces[1])]))
    hem, alike = _closest(inner, own, outer, faces[1], hems)
    outside = signed_distance(inner, outer, faces[1])
    covered = alike & (hem > HEM) & (np.abs(outside) < BELONGS) & (outside < STANDS_OUT)
    share, alike = _closest(outer, over, inner, faces[0], covered.astype(float))
    near = np.abs(signed_distance(outer, inner, faces[0])) < BELONGS
    return LayerPokes(faces, hems, covered, alike & near & (share > 0.5) & (hems > HEM))


def _closest(points, normals, vertices, faces, values) -> tuple[np.ndarray, np.ndarray]:
    """At the closest point of a surface to each of points (k, 3): what its vertices' values (m,) are there, and whether
    it faces as the point does, both (k,)."""
    _, face, share = closest_points(points, vertices, faces)
    corners = faces[face]
    outward = np.einsum("kj,kji->ki", share, vertex_normals(vertices, faces)[corners])
    # an infinite value, of cloth without an opening, times no share is no number
    value = (share * np.minimum(values, 1e9)[corners]).sum(axis=1)
    return value, np.einsum("ki,ki->k", outward, normals) > 0


@dataclass(frozen=True)
class Surface:
    """vertices: (n, 3) [m]. faces: (f, 3), facing outwards; of those removed may be left out."""

    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class View:
    """What each of R rays meets first. surface: (R,) its index, -1 for none. face: (R,) of that surface, share: (R, 3)
    barycentric there. distance: (R,) [m], infinite where none. facing: (R,) bool, its outside is seen."""

    surface: np.ndarray
    face: np.ndarray
    share: np.ndarray
    distance: np.ndarray
    facing: np.ndarray


def camera_rays(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (R, 3) of the rays of all cameras that look at the box about vertices (n, 3)."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, half = (low + high) / 2, np.linalg.norm(high - low) / 2
    pixel = (high - low)[2] / PIXELS_HIGH
    steps = np.arange(-half, half, pixel) + pixel / 2
    origins, directions = [], []
    for azimuth in np.arange(CAMERAS) * 2 * math.pi / CAMERAS:
        ahead = -np.array(
            [math.cos(ELEVATION) * math.cos(azimuth), math.cos(ELEVATION) * math.sin(azimuth), math.sin(ELEVATION)]
        )
        right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        up = np.cross(right, ahead)
        seen = (vertices - centre) @ np.stack([right, up], axis=1)
        across = steps[(steps > seen[:, 0].min()) & (steps < seen[:, 0].max())]
        along = steps[(steps > seen[:, 1].min()) & (steps < seen[:, 1].max())]
        grid = (across[:, None, None] * right + along[None, :, None] * up).reshape(-1, 3)
        origins.append(centre + grid - FAR / 2 * ahead)
        directions.append(np.broadcast_to(ahead, grid.shape))
    return np.concatenate(origins), np.concatenate(directions)


def look(surfaces: Sequence[Surface], rays: tuple[np.ndarray, np.ndarray]) -> View:
    """What the rays of `camera_rays` meet first."""
    from point_cloud_utils import ray_mesh_intersection

    first = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    starts = np.cumsum([0, *(len(surface.faces) for surface in surfaces)])
    vertices = np.concatenate([surface.vertices for surface in surfaces]).astype(np.float64)
    faces = np.concatenate([surface.faces + start for surface, start in zip(surfaces, first)]).astype(np.int64)
    if len(faces) == 0:
        nothing = np.full(len(rays[0]), -1)
        return View(nothing, nothing, np.zeros((len(nothing), 3)), np.full(len(nothing), np.inf), nothing > 0)
    origins, directions = (np.ascontiguousarray(x, dtype=np.float64) for x in rays)
    face, share, distance = ray_mesh_intersection(vertices, faces, origins, directions)
    face = np.asarray(face, dtype=np.int64)
    met = (face >= 0) & np.isfinite(distance)
    normal = _outward(vertices, faces[np.where(met, face, 0)])
    surface = np.where(met, np.searchsorted(starts, face, side="right") - 1, -1)
    return View(
        surface,
        np.where(met, face - starts[surface], -1),
        np.asarray(share),
        np.where(met, distance, np.inf),
        met & (np.einsum("ri,ri->r", normal, directions) < 0),
    )


def _outward(vertices: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Normals (k, 3) of faces with corners (k, 3) among vertices (n, 3), not of unit length."""
    a, b, c = vertices[corners].transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def holes(given: Sequence[Surface], removed: Sequence[Surface], rays: tuple[np.ndarray, np.ndarray]) -> View:
    """What each ray misses, of the removed surfaces; surface -1 where nothing.

    The outside of what is missed would be the first thing seen; within 5 cm behind it nothing that is given faces the
    camera; and nothing that is given lies there as another skin of the same shape, a few millimetres farther in: beside
    its outline a body only looks slimmer."""
    there, missing = look(given, rays), look(removed, rays)
    nearer = missing.facing & (missing.distance < there.distance)
    covered = there.facing & (there.distance < missing.distance + BEHIND)
    missed = np.flatnonzero(nearer & ~covered)
    points = rays[0][missed] + missing.distance[missed, None] * rays[1][missed]
    facing = np.empty_like(points)
    for index, surface in enumerate(removed):
        of = missing.surface[missed] == index
        facing[of] = _outward(surface.vertices, surface.faces[missing.face[missed[of]]])
    for surface in given:
        left = ~_lies_at(points, facing, surface)
        missed, points, facing = missed[left], points[left], facing[left]
    found = np.full(len(rays[0]), -1)
    found[missed] = missing.surface[missed]
    return replace(missing, surface=found)


def _lies_at(points: np.ndarray, facing: np.ndarray, surface: Surface) -> np.ndarray:
    """Whether a surface lies within 5 cm of points (k, 3) and faces as they do, at its closest point: (k,) bool. That
    must not be on its boundary."""
    if len(surface.faces) == 0 or len(points) == 0:
        return np.zeros(len(points), dtype=bool)
    distance, face, share = closest_points(points, surface.vertices, surface.faces)
    corners = surface.faces[face]
    alike = np.einsum("ki,ki->k", _outward(surface.vertices, corners), facing) > 0
    edges, count = mesh_edges(surface.faces)
    inside = (share > ON_EDGE) & ~np.isin(corners, edges[count == 1])
    return alike & (distance < BEHIND) & inside.any(axis=1)
