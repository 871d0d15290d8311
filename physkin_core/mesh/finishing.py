"""How a garment is finished: stitches along its seams and hems, and hems that are turned up, so that they have an edge.

Nothing of it is draped. It is drawn on faces of the draped garment, a little above or below them: `Finish` says which,
how far along the seam or hem each corner is and how far from it, on the flat cloth, so that a stitch is as long as it
is sewn. A turned-up hem is a second layer inside, joined to the first at the edge.
Dimensions: `f` faces of a garment, `n` its vertices, `w` vertices of a finish, `k` its faces. Metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.model.surface_paths import mesh_edges, pieces

__all__ = ["Finish", "stitching", "turned_up"]

CORNER = np.cos(np.radians(40.0))
"""A panel's edge that turns by more than this ends one line of stitches and begins another."""
REACH = 0.034
"""Stitches are sought so far from an edge."""


@dataclass(frozen=True)
class Finish:
    """Faces on a draped garment. vertices: (w,) of the garment, some repeated. above: (w,) how far along their normals
    they are. faces: (k, 3) of these; of: (k,) the garment's face that each follows. places: (k, 3, 2) of their corners
    in the material's picture."""

    vertices: np.ndarray
    above: np.ndarray
    faces: np.ndarray
    of: np.ndarray
    places: np.ndarray

    def of_faces(self, chosen: np.ndarray, faces: np.ndarray) -> Finish:
        """What of it follows some of the garment's faces (f, 3), a mask (f,): a finish of a garment that has no other
        faces, nor vertices that none of them uses."""
        kept = chosen[self.of]
        used, own = np.unique(self.faces[kept], return_inverse=True)
        vertices = np.searchsorted(np.unique(faces[chosen]), self.vertices[used])
        of = (np.cumsum(chosen) - 1)[self.of[kept]]
        return Finish(vertices, self.above[used], own.reshape(-1, 3), of, self.places[kept])

    def on(self, cloud: np.ndarray) -> np.ndarray:
        """(w, 6) float32 positions and normals on a garment's cloud (n, 6). What is turned up looks the other way."""
        normals = np.where(self.above < 0, -1, 1)[:, None] * cloud[self.vertices, 3:]
        return np.concatenate([self.placed(cloud[:, :3], cloud[:, 3:]), normals], axis=1).astype(np.float32)

    def placed(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(w, 3) where its vertices are on a garment with points and unit normals (n, 3)."""
        return points[self.vertices] + self.above[:, None] * normals[self.vertices]


@dataclass(frozen=True)
class _Line:
    """One run of a panel's edge. ends: (l, 2, 2) its straight pieces, in order. start: (l,) how far along each begins.
    panel: its own; other: the one it is sewn to, itself where it is none; hem: whether it is open."""

    ends: np.ndarray
    start: np.ndarray
    panel: int
    other: int
    hem: bool


def stitching(garment: Garment, lift: float) -> dict[str, Finish]:
    """Of a garment that was cut flat: "seams" on both sides of a seam, "felled" on that side to which its allowance is
    sewn down, "hems" along open edges. Their places are how far along the line of stitches, then how far from the edge.
    lift: how far above the cloth it is drawn."""
    panel = _panel_of_faces(garment)
    corners = garment.panel_places[garment.panel_faces]
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"seams": [], "felled": [], "hems": []}
    for line in _lines(garment, panel):
        faces = np.flatnonzero(panel == line.panel)
        low, high = line.ends.reshape(-1, 2).min(axis=0) - REACH, line.ends.reshape(-1, 2).max(axis=0) + REACH
        near = ((corners[faces] > low) & (corners[faces] < high)).all(axis=2).any(axis=1)
        faces = faces[near]
        along, away = _coordinates(line, corners[faces].reshape(-1, 2))
        along, away = along.reshape(-1, 3), away.reshape(-1, 3)
        near = away.min(axis=1) < (REACH if line.hem else REACH / 2)
        places = np.stack([along[near], away[near]], axis=-1)
        kind = "hems" if line.hem else "felled" if line.panel < line.other else "seams"
        found[kind].append((faces[near], places))
    return {kind: _on_faces(garment, parts, lift) for kind, parts in found.items()}


def turned_up(garment: Garment, depth: float, thickness: float) -> Finish:
    """Hems that are turned up so far, and so far inside: that second layer, and the edge that joins it."""
    open_sides = _open_sides(garment)
    distance = np.full(len(garment.vertices), np.inf)
    panel, corners = _panel_of_faces(garment), garment.panel_places[garment.panel_faces]
    for line in _lines(garment, panel):
        if line.hem:
            faces = np.flatnonzero(panel == line.panel)
            away = _coordinates(line, corners[faces].reshape(-1, 2))[1]
            np.minimum.at(distance, garment.faces[faces].reshape(-1), np.abs(away))
    chosen = np.flatnonzero((distance[garment.faces] < depth).all(axis=1))
    used, inner = np.unique(garment.faces[chosen], return_inverse=True)
    inner = inner.reshape(-1, 3)[:, ::-1]
    face, side = np.nonzero(open_sides & np.isin(np.arange(len(garment.faces)), chosen)[:, None])
    begin, end = garment.faces[face, side], garment.faces[face, (side + 1) % 3]
    rim, place = np.unique(np.concatenate([begin, end]), return_inverse=True)
    first, second = len(used) + place.reshape(2, -1)
    within = np.searchsorted(used, begin), np.searchsorted(used, end)
    joined = np.concatenate([np.stack([second, first, within[0]], axis=1), np.stack([second, within[0], within[1]], 1)])
    at_begin, at_end = corners[face, side], corners[face, (side + 1) % 3]
    return Finish(
        np.concatenate([used, rim]),
        np.concatenate([np.full(len(used), -thickness), np.zeros(len(rim))]),
        np.concatenate([inner, joined]),
        np.concatenate([chosen, face, face]),
        np.concatenate(
            [
                corners[chosen][:, ::-1],
                np.stack([at_end, at_begin, at_begin], 1),
                np.stack([at_end, at_begin, at_end], 1),
            ]
        ),
    )


def _open_sides(garment: Garment) -> np.ndarray:
    """(f, 3) bool, sides at which no other face is."""
    return np.bincount(garment.face_edges.reshape(-1))[garment.face_edges] == 1


def _panel_of_faces(garment: Garment) -> np.ndarray:
    """(f,) which of the pieces of flat cloth each face is on."""
    return pieces(mesh_edges(garment.panel_faces)[0], len(garment.panel_places))[garment.panel_faces[:, 0]]


def _lines(garment: Garment, panel: np.ndarray) -> Iterator[_Line]:
    """The edges of all panels, each in runs without corners that are sewn to one panel or open."""
    begin, end = garment.panel_faces, np.roll(garment.panel_faces, -1, axis=1)
    key = np.minimum(begin, end).astype(np.int64) * (begin.max() + 1) + np.maximum(begin, end)
    _, of, count = np.unique(key, return_inverse=True, return_counts=True)
    face, side = np.nonzero(count[of.reshape(key.shape)] == 1)
    following = {int(start): k for k, start in enumerate(begin[face, side])}
    after = np.array([following[int(place)] for place in end[face, side]])
    hem, other = _open_sides(garment)[face, side], _across(garment, panel)[face, side]
    ends = garment.panel_places[np.stack([begin[face, side], end[face, side]], axis=1)]
    direction = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(direction, axis=1)
    direction /= length[:, None]
    breaks = (direction * direction[after]).sum(axis=1) < CORNER
    breaks |= (hem != hem[after]) | (other != other[after])
    done = np.zeros(len(face), dtype=bool)
    starts = [*after[breaks], *range(len(face))]  # then closed lines without a corner
    for k in starts:
        run = []
        while not done[k]:
            done[k] = True
            run.append(k)
            if breaks[k]:
                break
            k = after[k]
        if run:
            start = np.cumsum([0.0, *length[run[:-1]]])
            yield _Line(ends[run], start, int(panel[face[run[0]]]), int(other[run[0]]), bool(hem[run[0]]))


def _across(garment: Garment, panel: np.ndarray) -> np.ndarray:
    """(f, 3) the panel of the face at the other side of each side, its own where there is none."""
    total = np.bincount(garment.face_edges.reshape(-1), np.repeat(panel, 3))[garment.face_edges].astype(int)
    return np.where(_open_sides(garment), panel[:, None], total - panel[:, None])


def _coordinates(line: _Line, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far along a line and how far from it, inwards, points (k, 2) of its panel are; beyond its ends it goes on
    straight."""
    first, second = line.ends[:, 0], line.ends[:, 1]
    direction = second - first
    length = np.linalg.norm(direction, axis=1)
    direction = direction / length[:, None]
    apart = points[:, None] - first
    share = (apart * direction).sum(axis=2)
    low, high = np.zeros(len(first)), length.copy()
    low[0], high[-1] = -np.inf, np.inf
    share = np.clip(share, low, high)
    distance = np.linalg.norm(apart - share[..., None] * direction, axis=2)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(points))
    return line.start[nearest] + share[rows, nearest], distance[rows, nearest]


def _on_faces(garment: Garment, parts: list[tuple[np.ndarray, np.ndarray]], lift: float) -> Finish:
    """A finish of faces of a garment and their corners' places."""
    of = np.concatenate([np.empty(0, dtype=int), *(faces for faces, _ in parts)])
    places = np.concatenate([np.empty((0, 3, 2)), *(places for _, places in parts)])
    used, faces = np.unique(garment.faces[of], return_inverse=True)
    return Finish(used, np.full(len(used), lift), faces.reshape(-1, 3), of, places)
