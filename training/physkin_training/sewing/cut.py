"""The cut: every panel of a pattern as even triangles, with the same number of vertices on both sides of a stitch.

Dimensions: `t` vertices of all panels, `f` triangles, `s` pairs of vertices that are sewn together, `k` vertices on a
panel's outline, `h` points of closures on it. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree
from trimesh.geometry import faces_to_edges

from physkin_core.model.rest_shape import flat_areas
from physkin_training.sewing.pattern import Panel, Pattern, PatternError

__all__ = ["EDGE_LENGTH_RANGE", "Cut", "cut"]

EDGE_LENGTH_RANGE = 0.006, 0.04  # [m]
FROM_OUTLINE = 0.7
"""Vertices inside a panel keep this distance from its outline and from points of closures, in edge lengths."""
HELD_APART = 0.005
"""[m] Points of closures keep this distance from the outline and from each other."""
BOLT, BETWEEN_PANELS = 1.5, 0.02
"""[m] width of the cloth that panels are laid out on, and what is left between them."""
SMALLEST_AREA = 5e-11  # [m2]
SMOOTHING = 15
"""Times that every vertex inside a panel goes to the middle of its neighbours."""


@dataclass(frozen=True)
class Cut:
    """Triangles of all panels.

    places: (t, 2) where vertices are on the flat cloth, the second axis along the grain, with all panels beside each
    other as they are laid out to be cut. drawn: (t, 2), as in the pattern. faces: (f, 3), counter-clockwise
    seen from outside. panel: (f,) index into `names` and `labels`. hung: (t, 3), about the body, see `Panel.hung`. seams: (s, 2), pairs of vertices that are sewn
    together. stitches: (s,), the stitch of each pair in words. threads: (c, 2), pairs of vertices that closures keep
    together, first the one that lies over the other.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    places: np.ndarray
    drawn: np.ndarray
    faces: np.ndarray
    panel: np.ndarray
    hung: np.ndarray
    seams: np.ndarray
    stitches: np.ndarray
    threads: np.ndarray

    @property
    def panel_of(self) -> np.ndarray:
        """(t,) index into `names` and `labels`, of vertices."""
        panel_of = np.empty(len(self.places), int)
        panel_of[self.faces] = self.panel[:, None]
        return panel_of


def cut(pattern: Pattern, edge_length: float) -> Cut:
    """Triangulate the panels of a pattern. edge_length: mean length of the triangles' edges [m].

    Raises PatternError for an edge length out of EDGE_LENGTH_RANGE, or too long for a panel, and for closures at points
    outside their panels or within HELD_APART of an outline or of each other.
    """
    least, most = EDGE_LENGTH_RANGE
    if not least <= edge_length <= most:
        raise PatternError(f"edge length {edge_length} m, allowed are {least} to {most} m")
    segments = _segments(pattern, edge_length)
    drawn, faces, owners, hung, on_edge, held, first = [], [], [], [], {}, {}, 0
    for index, panel in enumerate(pattern.panels.values()):
        outline = []
        for number, edge in enumerate(panel.edges):
            points = edge.points(segments[panel.name, number])[:-1]
            on_edge[panel.name, number] = first + len(outline) + np.arange(len(points) + 1)
            outline += list(points)
        on_edge[panel.name, len(panel.edges) - 1][-1] = first
        vertices, triangles = triangulated(panel, np.array(outline), edge_length)
        held[panel.name] = first + len(outline)
        drawn.append(vertices)
        faces.append(first + triangles)
        owners.append(np.full(len(triangles), index))
        hung.append(panel.hung(vertices))
        first += len(vertices)
    seams = [np.column_stack([on_edge[one], on_edge[other][::-1]]) for one, other in pattern.stitches]
    corners = laid_out([np.ptp(own, axis=0) for own in drawn])
    places = [own - own.min(axis=0) + corner for own, corner in zip(drawn, corners, strict=True)]
    return Cut(
        tuple(pattern.panels),
        tuple(panel.label for panel in pattern.panels.values()),
        *map(np.concatenate, (places, drawn, faces, owners, hung)),
        np.concatenate([*seams, np.zeros((0, 2), int)]),
        np.repeat(pattern.named, [len(pairs) for pairs in seams]),
        np.reshape([held[name] + index for pair in pattern.closures for name, index in pair], (-1, 2)).astype(int),
    )


def laid_out(sizes: list[np.ndarray]) -> np.ndarray:
    """Lower left corners (p, 2) [m] of panels of such widths and heights on a bolt of cloth, in rows, the highest
    first."""
    corners, x, y, row = np.zeros((len(sizes), 2)), 0.0, 0.0, 0.0
    for panel in sorted(range(len(sizes)), key=lambda panel: -sizes[panel][1]):
        width, height = sizes[panel] + BETWEEN_PANELS
        if x and x + width > BOLT:
            x, y, row = 0.0, y + row, 0.0
        corners[panel] = x, y
        x, row = x + width, max(row, height)
    return corners


def _segments(pattern: Pattern, edge_length: float) -> dict[tuple[str, int], int]:
    """Into how many pieces each edge, (panel name, index), is divided; both sides of a stitch alike."""
    lengths = {
        (panel.name, index): [edge.length]
        for panel in pattern.panels.values()
        for index, edge in enumerate(panel.edges)
    }
    for pair in pattern.stitches:
        both = [pattern.edge(side).length for side in pair]
        lengths.update(dict.fromkeys(pair, both))
    return {edge: max(1, round(float(np.mean(length)) / edge_length)) for edge, length in lengths.items()}


def triangulated(panel: Panel, outline: np.ndarray, edge_length: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (t, 2) [m], those of `outline` (k, 2) first and then `panel.held`, and faces (f, 3) of a panel:
    Delaunay's of these and of a hexagonal lattice inside the outline, smoothed."""
    fixed = np.concatenate([outline, _checked_held(panel, outline)])
    inner = _lattice(outline, edge_length)
    if len(inner) and len(panel.held):
        inner = inner[cKDTree(panel.held).query(inner)[0] > FROM_OUTLINE * edge_length]
    for _ in range(SMOOTHING):
        points = np.concatenate([fixed, inner])
        faces = _inside_faces(points, outline)
        sides = np.unique(np.sort(faces_to_edges(faces), axis=1), axis=0)
        both = np.concatenate([sides, sides[:, ::-1]])
        count = np.maximum(np.bincount(both[:, 0], minlength=len(points)), 1)
        middle = np.stack([np.bincount(both[:, 0], axis[both[:, 1]], len(points)) for axis in points.T], axis=1)
        inner = (middle / count[:, None])[len(fixed) :]
    points = np.concatenate([fixed, inner])
    faces = _inside_faces(points, outline)
    k = len(outline)
    there = np.isin(np.arange(k) * len(points) + (np.arange(k) + 1) % k, faces_to_edges(faces) @ [len(points), 1])
    if not there.all() or len(np.unique(faces)) < len(points):
        x, y = outline[np.argmin(there)] if not there.all() else points[np.setdiff1d(np.arange(len(points)), faces)[0]]
        raise PatternError(
            f"panel {panel.name!r} is too narrow at ({x:.3f}, {y:.3f}) m for edges of {edge_length:g} m; give a "
            "shorter edge length"
        )
    return points, faces


def _checked_held(panel: Panel, outline: np.ndarray) -> np.ndarray:
    """The points (h, 2) of closures of a panel. Raises PatternError."""
    away = np.where(_inside(panel.held, outline), cKDTree(_along(outline, 50)).query(panel.held)[0], -1.0)
    others = np.linalg.norm(panel.held[:, None] - panel.held, axis=2) + np.diag(np.full(len(panel.held), np.inf))
    for point, (x, y) in enumerate(panel.held):
        nearest = others[point].min()
        if min(away[point], nearest) < HELD_APART:
            where = "is outside it" if away[point] < 0 else f"is {1000 * away[point]:.1f} mm from its outline"
            where = where if away[point] < HELD_APART else f"is {1000 * nearest:.1f} mm from another one"
            raise PatternError(
                f"panel {panel.name!r}: the closure at ({x:.3f}, {y:.3f}) m {where}; allowed are points inside, "
                f"{1000 * HELD_APART:g} mm from its outline and from each other"
            )
    return panel.held


def _along(outline: np.ndarray, samples: int) -> np.ndarray:
    """Points (k * samples, 2) on the outline (k, 2)."""
    share = np.linspace(0.0, 1.0, samples + 1)[:-1, None, None]
    return ((1 - share) * outline + share * np.roll(outline, -1, axis=0)).reshape(-1, 2)


def _lattice(outline: np.ndarray, edge_length: float) -> np.ndarray:
    """(i, 2) points inside the outline, `FROM_OUTLINE` edge lengths away from it."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    half = np.ceil((high - low) / 2 / edge_length / [1.0, np.sqrt(0.75)]).astype(int) + 1
    column, row = np.meshgrid(np.arange(-half[0], half[0] + 1), np.arange(-half[1], half[1] + 1))
    points = np.stack([column + np.abs(row) % 2 / 2.0, row * np.sqrt(0.75)], axis=-1) * edge_length
    points = points.reshape(-1, 2) + (low + high) / 2
    points = points[_inside(points, outline)]
    return points[cKDTree(_along(outline, 4)).query(points)[0] > FROM_OUTLINE * edge_length] if len(points) else points


def _inside_faces(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Delaunay's triangles (f, 3) inside the outline, counter-clockwise."""
    faces = Delaunay(points).simplices
    areas = flat_areas(points[faces])
    faces = np.where(areas[:, None] > 0, faces, faces[:, ::-1])
    return faces[_inside(points[faces].mean(axis=1), outline) & (np.abs(areas) > SMALLEST_AREA)]


def _inside(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(p,) bool: points (p, 2) inside the closed outline (k, 2), by the crossings of a ray."""
    start, end = outline, np.roll(outline, -1, axis=0)
    y = points[:, 1, None]
    crosses = (start[:, 1] > y) != (end[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = start[:, 0] + (y - start[:, 1]) * (end[:, 0] - start[:, 0]) / (end[:, 1] - start[:, 1])
    return (crosses & (points[:, 0, None] < at)).sum(axis=1) % 2 == 1
