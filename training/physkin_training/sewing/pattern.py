"""Sewing patterns: flat panels, how they hang about a body, and which of their edges are sewn together.

The format is GarmentCode's (Korosteleva and Sorkine-Hornung 2023), JSON. Its frame has Y up and Z forward, its unit is
mostly the centimetre; what is read here is in metres, X forward, Y left, Z up, above the floor that the body stands on.

Dimensions: `v` corners of a panel, `k` points along an edge.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError, read_bytes, read_json, reading, sentence, shown

__all__ = ["Edge", "Panel", "Pattern", "PatternError", "load_pattern"]

log = logging.getLogger(__name__)
LARGEST_PATTERN = 1 << 22  # [bytes]
LARGEST_GATHER = 3.0
"""An edge may be at most so many times as long as the one it is sewn to."""
EXTENT = 0.15, 4.0
"""Width or height [m] of all panels together, from the smallest garment to the largest. Others are in another unit."""
SHORTEST_EDGE = 1e-3  # [m]
CURVE_SAMPLES = 200
CROSSING = 0.2
"""A seam crosses if the ends that it sews together lie farther apart than the other way around, in its shorter edges'
lengths. In GarmentCode's patterns it is at most 0.09, of panels drawn in the wrong direction 0.48 and more."""
TOWARDS_BODY = (0.3, 1.0, 1.0)
"""How much distances count for that: panels hang well before and behind the body."""

TO_ROOT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""From Y up, Z forward to Z up, X forward."""


class PatternError(ValueError):
    """A sewing pattern cannot be used."""


@dataclass(frozen=True)
class Edge:
    """One edge of a panel: places (CURVE_SAMPLES + 1, 2) [m] in the panel's plane, from corner to corner, along the
    curve. label: what the pattern calls it, or empty."""

    curve: np.ndarray
    label: str

    @cached_property
    def _travelled(self) -> np.ndarray:
        """(CURVE_SAMPLES + 1,) [m] from the edge's start."""
        return np.concatenate([[0.0], np.linalg.norm(np.diff(self.curve, axis=0), axis=1).cumsum()])

    @property
    def length(self) -> float:
        """[m]"""
        return float(self._travelled[-1])

    def points(self, segments: int) -> np.ndarray:
        """(segments + 1, 2) [m], evenly spaced along the edge, both ends among them."""
        along = np.linspace(0.0, self.length, segments + 1)
        return np.column_stack([np.interp(along, self._travelled, axis) for axis in self.curve.T])


@dataclass(frozen=True)
class Panel:
    """A flat piece of cloth, seen from outside the garment: its second axis goes along the grain.

    edges: in order, counter-clockwise. axes: (3, 2), where the plane's axes point as it hangs about the body, and
    place: (3,) [m], where their origin is. label: the part of the body it is for, `body`, `arm` or `leg`, or empty.
    held: (h, 2) [m], its points of closures.
    """

    name: str
    edges: tuple[Edge, ...]
    axes: np.ndarray
    place: np.ndarray
    label: str
    held: np.ndarray

    def hung(self, places: np.ndarray) -> np.ndarray:
        """Places (..., 2) of its plane about the body (..., 3) [m]."""
        return places @ self.axes.T + self.place

    def turned(self) -> Panel:
        """Its edges the other way around, the last one first, so that its other side is outside."""
        edges = tuple(Edge(edge.curve[::-1] * (-1.0, 1.0), edge.label) for edge in self.edges[::-1])
        return replace(self, edges=edges, axes=self.axes * (-1.0, 1.0), held=self.held * (-1.0, 1.0))


@dataclass(frozen=True)
class Pattern:
    """panels: by name. stitches: pairs of (panel name, index of its edge) that are sewn together, point by point over
    their whole length, the second one against its direction. named: what each of them is in the file. closures: pairs
    of (panel name, index of a point in its `held`) that are kept together, first the one that lies over the other."""

    panels: dict[str, Panel]
    stitches: tuple[tuple[tuple[str, int], tuple[str, int]], ...]
    named: tuple[str, ...]
    closures: tuple[tuple[tuple[str, int], tuple[str, int]], ...] = ()

    def edge(self, side: tuple[str, int]) -> Edge:
        """Of a stitch's side."""
        return self.panels[side[0]].edges[side[1]]


Real = Annotated[float, Field(allow_inf_nan=False)]
Two, Three = tuple[Real, Real], tuple[Real, Real, Real]


@checked(frozen=True)
class _Bend:
    """As in the file. Of a circle: radius in the pattern's unit, whether the large arc, whether to the right."""

    type: Literal["quadratic", "cubic", "circle"]
    params: list[Two] | Three


def _older_bend(given: object) -> object:
    """The control point of a quadratic curve by itself, as older patterns have it, or what is given."""
    return {"type": "quadratic", "params": [given]} if isinstance(given, list) else given


@checked(frozen=True)
class _Edge:
    endpoints: tuple[int, int]
    curvature: Annotated[_Bend | None, BeforeValidator(_older_bend)] = None
    label: str = ""


@checked(frozen=True)
class _Panel:
    vertices: Annotated[list[Two], Field(min_length=3, max_length=1000)]
    edges: Annotated[list[_Edge], Field(min_length=3, max_length=1000)]
    translation: Three
    rotation: Three
    label: str = ""


@checked(frozen=True)
class _Side:
    panel: str
    edge: int


@checked(frozen=True)
class _Point:
    panel: str
    at: Two


MARK = "right_wrong"
"""Of a seam that GarmentCode sews start to start, the right side of one panel on the wrong side of the other."""


def _with_mark(stitch: object) -> object:
    return [*stitch, None] if isinstance(stitch, list) and len(stitch) == 2 else stitch


_Stitch = Annotated[tuple[_Side, _Side, Literal["right_wrong", None]], BeforeValidator(_with_mark)]


@checked(frozen=True)
class _Panels:
    panels: Annotated[dict[str, _Panel], Field(min_length=1, max_length=1000)]
    stitches: Annotated[list[_Stitch], Field(max_length=10000)]
    closures: Annotated[list[tuple[_Point, _Point]], Field(max_length=1000)] = Field(default_factory=list)


@checked(frozen=True)
class _Properties:
    units_in_meter: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    curvature_coords: Literal["relative"] = "relative"


@checked(frozen=True)
class _File:
    pattern: _Panels
    properties: _Properties


def load_pattern(path: str | Path) -> Pattern:
    """Read a sewing pattern. Raises PatternError: not a pattern, another unit, a panel that crosses itself, a stitch of
    an edge that is not there or is sewn twice, or of lengths that differ by more than a gather of 3."""
    path = Path(path)
    with reading(f"pattern {path}", PatternError):
        data = read_json(read_bytes(path, most=LARGEST_PATTERN))
        try:
            file = TypeAdapter(_File).validate_python(data)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, first["loc"]))
            raise ContentError(f"{shown(place)}: {first['msg'].lower()}, got {shown(first['input'])}") from error
        metres = 1 / file.properties.units_in_meter
        held, closures = _held(file.pattern)
        panels = {name: _panel(name, panel, held[name], metres) for name, panel in file.pattern.panels.items()}
        _check_extent(panels.values(), file.properties.units_in_meter)
        for panel in panels.values():
            _check_outline(panel)
        each: dict[frozenset, tuple] = {}
        for stitch in file.pattern.stitches:
            each.setdefault(frozenset((side.panel, side.edge) for side in stitch[:2]), stitch)
        stitches = tuple(tuple((side.panel, side.edge) for side in pair) for *pair, _ in each.values())
        _check_stitches(panels, stitches)
        marked = np.array([mark is not None for *_, mark in each.values()], dtype=bool)
        found = _directed(panels, stitches, marked, lambda text: log.warning("%s", sentence(f"pattern {path}: {text}")))
        return replace(found, closures=closures)


def _held(pattern: _Panels) -> tuple[dict[str, list[Two]], tuple]:
    """Points of closures by panel, in the file's unit, and `Pattern.closures`."""
    held: dict[str, list[Two]] = {name: [] for name in pattern.panels}
    for number, pair in enumerate(pattern.closures):
        for point in pair:
            if point.panel not in held:
                raise ContentError(f"closure {number} is of panel {shown(point.panel)}, which there is not")
            held[point.panel].append(point.at)
    place = {name: iter(range(len(points))) for name, points in held.items()}
    return held, tuple(tuple((point.panel, next(place[point.panel])) for point in pair) for pair in pattern.closures)


def _panel(name: str, panel: _Panel, held: list[Two], metres: float) -> Panel:
    corners, edges = np.array(panel.vertices) * metres, []
    for index, edge in enumerate(panel.edges):
        if not all(0 <= end < len(corners) for end in edge.endpoints):
            raise ContentError(
                f"panel {shown(name)}, edge {index}: endpoints {shown(edge.endpoints)}, allowed 0 to {len(corners) - 1}"
            )
        start, end = corners[list(edge.endpoints)]
        try:
            curve = _curve(start, end, edge.curvature, metres)
        except ContentError as error:
            raise ContentError(f"panel {shown(name)}, edge {index}: {error}") from error
        edges.append(Edge(curve, edge.label))
        if edges[-1].length < SHORTEST_EDGE:
            raise ContentError(
                f"panel {shown(name)}, edge {index} is {1000 * edges[-1].length:.2g} mm long, at least "
                f"{1000 * SHORTEST_EDGE:g} are needed"
            )
    for index, (edge, following) in enumerate(pairwise([*panel.edges, panel.edges[0]])):
        if edge.endpoints[1] != following.endpoints[0]:
            raise ContentError(
                f"panel {shown(name)}, edge {index} ends at corner {edge.endpoints[1]} and the next one starts at "
                f"{following.endpoints[0]}; the edges of a panel must be one closed loop in order"
            )
    axes = TO_ROOT @ Rotation.from_euler("XYZ", panel.rotation, degrees=True).as_matrix()[:, :2]
    points = np.reshape(held, (-1, 2)) * metres
    outline = np.concatenate([edge.curve[:-1] for edge in edges])
    following = np.roll(outline, -1, axis=0)
    if (outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum() < 0:  # drawn from inside
        edges = [Edge(edge.curve * (-1.0, 1.0), edge.label) for edge in edges]
        axes, points = axes * (-1.0, 1.0), points * (-1.0, 1.0)
    return Panel(name, tuple(edges), axes, TO_ROOT @ panel.translation * metres, panel.label, points)


def _curve(start: np.ndarray, end: np.ndarray, bend: _Bend | None, metres: float) -> np.ndarray:
    """(CURVE_SAMPLES + 1, 2) [m]."""
    along = end - start
    across = np.array([-along[1], along[0]])
    share = np.linspace(0.0, 1.0, CURVE_SAMPLES + 1)[:, None]
    if bend is None:
        return start + share * along
    if bend.type == "circle":
        if not isinstance(bend.params, tuple):
            raise ContentError(f"a circle needs radius, large arc and side, got {shown(bend.params)}")
        radius, large, right = bend.params
        return _arc(start, end, radius * metres, bool(large), bool(right), share)
    controls = {"quadratic": 1, "cubic": 2}[bend.type]
    if isinstance(bend.params, tuple) or len(bend.params) != controls:
        raise ContentError(f"a {bend.type} curve needs {controls} control points, got {shown(bend.params)}")
    points = [start, *(start + x * along + y * across for x, y in bend.params), end]
    while len(points) > 1:  # de Casteljau
        points = [(1 - share) * p + share * q for p, q in pairwise(points)]
    return points[0]


def _arc(start: np.ndarray, end: np.ndarray, radius: float, large: bool, right: bool, share: np.ndarray) -> np.ndarray:
    """(CURVE_SAMPLES + 1, 2) [m] along a circle from start to end, with the arc right or left of the chord."""
    chord = end - start
    half = np.linalg.norm(chord) / 2
    if radius < half * (1 - 1e-4):
        raise ContentError(f"a circle of radius {radius:.4g} m is too small for its chord of {2 * half:.4g} m")
    side = 1.0 if right else -1.0
    left = np.array([-chord[1], chord[0]]) / (2 * half)
    height = np.sqrt(max(radius**2 - half**2, 0.0)) * (-1.0 if large else 1.0)
    centre = (start + end) / 2 + side * height * left
    angle = 2 * np.arcsin(min(half / radius, 1.0))
    angle = side * (2 * np.pi - angle if large else angle)
    begins = np.arctan2(*(start - centre)[::-1])
    turned = begins + share * angle
    return centre + radius * np.concatenate([np.cos(turned), np.sin(turned)], axis=1)


def _check_extent(panels: list[Panel], units: float) -> None:
    hung = np.concatenate([panel.hung(edge.curve) for panel in panels for edge in panel.edges])
    extent = float(np.ptp(hung, axis=0).max())
    least, most = EXTENT
    if not least <= extent <= most:
        raise ContentError(
            f"its panels are {extent:.3g} m wide or high at {units:g} units a metre (units_in_meter), allowed "
            f"are {least} to {most} m: it is probably in another unit"
        )


def _check_outline(panel: Panel) -> None:
    """No two edges cross, and none crosses itself."""
    samples = 24
    loop = np.concatenate([edge.points(samples)[:-1] for edge in panel.edges])
    owner = np.repeat(np.arange(len(panel.edges)), samples)
    step = np.roll(loop, -1, axis=0) - loop
    across = step[:, None, 0] * step[None, :, 1] - step[:, None, 1] * step[None, :, 0]
    gap = loop[None] - loop[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        mine = (gap[..., 0] * step[None, :, 1] - gap[..., 1] * step[None, :, 0]) / across
        others = (gap[..., 0] * step[:, None, 1] - gap[..., 1] * step[:, None, 0]) / across
    inside = (mine > 1e-6) & (mine < 1 - 1e-6) & (others > 1e-6) & (others < 1 - 1e-6)
    crossing = np.argwhere(np.triu(inside, 2))
    if len(crossing):
        first, second = owner[crossing[0]]
        raise ContentError(f"panel {shown(panel.name)} crosses itself: its edges {first} and {second} do")


def _check_stitches(panels: dict[str, Panel], stitches: tuple) -> None:
    sewn: set[tuple[str, int]] = set()
    for number, pair in enumerate(stitches):
        for name, edge in pair:
            if name not in panels:
                raise ContentError(f"stitch {number} is of panel {shown(name)}, which there is not")
            if not 0 <= edge < len(panels[name].edges):
                raise ContentError(
                    f"stitch {number} is of edge {edge} of panel {shown(name)}, allowed are 0 to "
                    f"{len(panels[name].edges) - 1}"
                )
            if (name, edge) in sewn:
                raise ContentError(f"edge {edge} of panel {shown(name)} is sewn twice, in stitch {number} again")
            sewn.add((name, edge))
        (first, i), (second, j) = pair
        lengths = panels[first].edges[i].length, panels[second].edges[j].length
        if max(lengths) > LARGEST_GATHER * min(lengths):
            raise ContentError(
                f"stitch {number} sews edge {i} of panel {shown(first)}, {lengths[0]:.3f} m, to edge {j} of "
                f"{shown(second)}, {lengths[1]:.3f} m: one may be at most {LARGEST_GATHER:g} times as long as the other"
            )


def _directed(panels: dict[str, Panel], stitches: tuple, marked: np.ndarray, warn: Callable[[str], None]) -> Pattern:
    """Panels turned over that are drawn in the wrong direction for their stitches, as they hang, or are sewn with their
    wrong side out. marked: (stitches,) those that are to be sewn start to start."""
    named = tuple(f"edge {i} of panel {shown(one)} to edge {j} of {shown(other)}" for (one, i), (other, j) in stitches)
    pairs = np.searchsorted(names := sorted(panels), [[name for name, _ in pair] for pair in stitches]).reshape(-1, 2)
    hung = [[panels[name].hung(panels[name].edges[i].curve[[0, -1]]) for name, i in pair] for pair in stitches]
    one, other = np.reshape(hung, (-1, 2, 2, 3)).swapaxes(0, 1) * TOWARDS_BODY
    apart, swapped = (np.linalg.norm(one - ends, axis=2).sum(axis=1) for ends in (other[:, ::-1], other))
    shorter = np.minimum(*(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) for ends in (one, other)))
    crossing = np.where(marked, swapped - apart, apart - swapped) / np.maximum(shorter, SHORTEST_EDGE)
    certain = np.where(marked, 0.1, 1.0) * np.where(np.abs(crossing) > CROSSING, crossing, 0.0)
    drawn_wrong = _turned_over(pairs, certain, len(names))
    for index in np.flatnonzero(drawn_wrong):
        warn(f"panel {shown(names[index])} is drawn in the wrong direction for its stitches; it is turned over")
    crosses = np.where(drawn_wrong[pairs].sum(axis=1) == 1, -crossing, crossing) > CROSSING
    for stitch in np.flatnonzero(crosses & ~marked):
        raise ContentError(f"stitch {stitch} sews {named[stitch]}: it would cross, as these panels hang")
    wrong_side = _turned_over(pairs, np.where(marked & ~crosses, 0.1, -1.0), len(names))
    for stitch in np.flatnonzero(crosses | marked ^ (wrong_side[pairs].sum(axis=1) == 1)):
        warn(f"{named[stitch]} would cross or twist if sewn start to start ({MARK!r}); it is sewn end to start")
    turned = dict(zip(names, drawn_wrong ^ wrong_side))
    found = {name: panel.turned() if turned[name] else panel for name, panel in panels.items()}
    last = {name: len(panel.edges) - 1 for name, panel in panels.items()}
    sides = (tuple((name, last[name] - i if turned[name] else i) for name, i in pair) for pair in stitches)
    return Pattern(found, tuple(sides), named)


def _turned_over(pairs: np.ndarray, cost: np.ndarray, count: int) -> np.ndarray:
    """Which of `count` panels (count,), the fewer ones, to turn over so that seams between panels `pairs` (s, 2) cost
    least: their `cost` (s,), its opposite where one of both is turned. The strongest decide."""
    between = np.zeros((count, count))
    np.add.at(between, tuple(np.sort(pairs, axis=1).T), cost)
    sewn = np.argwhere(np.triu(between, 1))
    sign, group = np.ones(count), np.arange(count)
    for one, other in sewn[np.argsort(-np.abs(between[tuple(sewn.T)]), kind="stable")]:
        members = group == group[other]
        if not members[one]:
            sign[members] *= -np.sign(sign[one] * sign[other] * between[one, other])
            group[members] = group[one]
    return sign * np.where(np.bincount(group, sign, count) < 0, -1, 1)[group] < 0
