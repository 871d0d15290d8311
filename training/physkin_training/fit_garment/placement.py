"""Where a garment mesh belongs on a body: its unit, its axes and its place.

As it lies on an avatar in that one's own pose; else found by trying: every reading (unit, axes, place) is judged by how
closely it wraps the body, and the one that changes least wins unless another one fits clearly better.
Dimensions: `n` vertices. Metres, root frame (X forward, Y left, Z up).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from scipy.spatial import cKDTree

from physkin_training.contact.surface_queries import BodySurface
from physkin_training.fit_garment.own_pose import OwnPose

__all__ = [
    "MOST_BURIED", "MOST_COST", "UNITS", "WORN", "Placement", "best_scale", "buried", "turned_over", "find_lying",
    "find_placement",
]  # fmt: skip

UNITS = {"metres": 1.0, "decimetres": 0.1, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
EXTENT_RANGE = (0.3, 2.5)
"""[m] a garment's longest extent."""
FAR = 0.15
"""Distance [m] beyond which a vertex is no farther from the body: skirts hang free."""
INSIDE = 4.0
"""A vertex in the body counts as if so many times as far from it."""
MOSTLY_INSIDE = 0.1
"""Share of vertices in the body from which on other places are tried."""
BURIED, MOST_BURIED = 0.005, 0.03
"""A vertex this deep [m] in the body is buried; a garment lies on the body with less than this share of them."""
TRIED_POINTS = 300
CLEARLY, MUCH = 0.8, 0.6
"""Another unit or turn must cost less than this share of the simpler one; and another place less than that."""
WORN, MOST_COST = 0.1, 0.12
"""[m] cost from which on other places are tried, and the largest of a garment that is worn anywhere; the shipped ones
have 0.02 to 0.08, the skirt the most, a wide dress to the floor 0.11."""
HEIGHT_STEP, FORWARD_STEPS = 0.03, (-0.05, 0.0, 0.05)
"""[m] of the coarse search for a place, whose best `STARTS` are settled finely."""
STARTS = 4
TURNED_HEIGHTS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""[m] from where a garment that is turned over is settled."""
READINGS = (
    ("X", "Z"), ("Z", "Y"), ("-Z", "Y"), ("-Y", "Z"), ("-X", "Z"), ("X", "Y"), ("-X", "Y"), ("Y", "Z"),
)  # fmt: skip
"""The file's axes that may be forward and up, the likely ones first."""
SCALES = (0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15)


@dataclass(frozen=True)
class Placement:
    """How to read a mesh: x = scale * turn @ file + shift. cost [m]: of `Fit.cost` there.

    unit: what `scale` [m] is called. turn: (3, 3) rotation by quarters. shift: (3,) [m]. searched: the shift is the
    closest fit, not one of the usual origins; then front and back of a garment that is alike on both can be mistaken.
    """

    unit: str
    scale: float
    turn: np.ndarray
    shift: np.ndarray
    cost: float
    searched: bool = False

    def applied(self, vertices: np.ndarray) -> np.ndarray:
        """File coordinates (..., 3) as root frame [m]."""
        return self.scale * vertices @ self.turn.T + self.shift

    @property
    def axes(self) -> str:
        """What the file's axes are, in words."""
        return f"{_axis(self.turn[2])} up, {_axis(self.turn[0])} forward"


class Fit:
    """Costs of garment points on a body."""

    def __init__(self, body: BodySurface) -> None:
        self.body = body
        self._tree = cKDTree(body.vertices)

    def cost(self, points: np.ndarray) -> np.ndarray:
        """Mean distance [m] to the body of each set of points (..., n, 3), more for points in it. Returns (...)."""
        distance, near = self._tree.query(points)
        weight = np.where(self._behind(points, near), INSIDE, 1.0)
        return (np.minimum(distance, FAR) * weight).mean(axis=-1)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Which points (..., n, 3) are in the body, by its nearest vertex. Returns (..., n) bool."""
        return self._behind(points, self._tree.query(points)[1])

    def _behind(self, points: np.ndarray, near: np.ndarray) -> np.ndarray:
        return ((points - self.body.vertices[near]) * self.body.normals[near]).sum(axis=-1) < 0

    def settled(self, points: np.ndarray, shift: np.ndarray, step: float) -> tuple[np.ndarray, float]:
        """The shift of least cost near `shift`, to a millimetre, and its cost."""
        least = float(self.cost(points + shift))
        while step > 1e-3:
            ways = shift + step * np.concatenate([np.eye(3), -np.eye(3)])
            costs = self.cost(points + ways[:, None])
            if costs.min() < 0.999 * least:
                shift, least = ways[costs.argmin()], float(costs.min())
            else:
                step /= 2
        return shift, least


def find_lying(vertices: np.ndarray, own: OwnPose, body: BodySurface) -> list[Placement]:
    """The readings in which vertices (n, 3), in the file's coordinates, lie on an avatar in its own pose as they are,
    with the avatar's origin: the best one, then those that it may be mistaken for. Unit and axes are the avatar's where
    it lies so. body: the surface of `own`. Raises ValueError when no unit gives a garment's size.
    """
    fit, tried = Fit(body), _some(vertices)
    named = [name for name, metres in UNITS.items() if abs(own.scale / metres - 1) < 1e-3]
    shared = Placement(*(named or ["the avatar's unit"]), own.scale, own.turn, own.shift, 0.0)
    others = [
        Placement(unit, scale, turn, own.shift, 0.0)
        for turn in quarter_turns()
        for unit, scale in _likely_units(vertices).items()
    ]
    found = []
    for reading in (shared, *others):
        cost = float(fit.cost(reading.applied(tried)))
        if cost <= WORN and buried(reading.applied(vertices), body) < MOST_BURIED:
            found.append(replace(reading, cost=cost))
            if reading is shared:
                return found
    found.sort(key=lambda reading: reading.cost)
    return [reading for reading in found if CLEARLY * reading.cost <= found[0].cost]


def buried(points: np.ndarray, body: BodySurface) -> float:
    """Share of points (n, 3) that lie deep in the body."""
    return float((body.closest(points).distance < -BURIED).mean())


def turned_over(points: np.ndarray, body: BodySurface) -> tuple[np.ndarray, np.ndarray, float]:
    """Points (n, 3) [m] as they are and head down, each where it fits best nearby, and what they cost head down, as a
    share of what they cost as they are."""
    fit = Fit(body)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    starts = [np.array([0.0, 0.0, height]) for height in TURNED_HEIGHTS]

    def settled(turn: list[int]) -> tuple[np.ndarray, float]:
        turned = (points - centre) * turn + centre
        shift, cost = min((fit.settled(_some(turned), start, HEIGHT_STEP) for start in starts), key=lambda to: to[1])
        return turned + shift, cost

    over, cost = min(settled([1, -1, -1]), settled([-1, 1, -1]), key=lambda found: found[1])
    upright, own_cost = settled([1, 1, 1])
    return upright, over, cost / own_cost


def find_placement(vertices: np.ndarray, body: BodySurface) -> Placement:
    """The simplest reading of vertices (n, 3), in the file's coordinates, that fits the body.

    Raises ValueError when no unit gives a garment's size.
    """
    fit, tried = Fit(body), _some(vertices)
    units = _likely_units(vertices)
    box = np.stack([vertices.min(axis=0), vertices.max(axis=0)]).mean(axis=0)
    readings = [
        (Placement(unit, scale, turn, np.zeros(3), 0.0), *(scale * array @ turn.T for array in (tried, box)))
        for turn in quarter_turns()
        for unit, scale in units.items()
    ]
    floor = np.array([0.0, 0.0, body.vertices[:, 2].min()])
    best, standing = (
        _simplest(
            replace(reading, shift=shift, cost=float(fit.cost(points + shift))) for reading, points, _ in readings
        )
        for shift in (np.zeros(3), floor)
    )
    best = _moved_if_better(best, standing)
    if best.cost <= WORN and fit.inside(best.applied(tried)).mean() < MOSTLY_INSIDE:
        return best
    other = _simplest(_best_place(fit, *reading) for reading in readings)
    return _moved_if_better(best, other)


def _some(vertices: np.ndarray) -> np.ndarray:
    """`TRIED_POINTS` of the vertices (n, 3), or all of them."""
    return vertices[np.linspace(0, len(vertices) - 1, min(TRIED_POINTS, len(vertices))).astype(int)]


def _likely_units(vertices: np.ndarray) -> dict[str, float]:
    """Of `UNITS` those in which vertices (n, 3) have a garment's size."""
    longest = float(np.ptp(vertices, axis=0).max())
    low, high = EXTENT_RANGE
    units = {unit: metres for unit, metres in UNITS.items() if low <= longest * metres <= high}
    if not units:
        raise ValueError(
            f"the garment's longest extent is {longest:.4g} units; in {', '.join(UNITS)} it must be {low} to {high} m"
        )
    return units


def _simplest(readings: Iterable[Placement]) -> Placement:
    """The first one, unless a later one costs clearly less."""
    return reduce(lambda best, other: other if other.cost < CLEARLY * best.cost else best, readings)


def _moved_if_better(best: Placement, other: Placement) -> Placement:
    """Another place for a garment that may well be worn where it is only if that costs much less."""
    return other if other.cost < (MUCH if best.cost <= WORN else CLEARLY) * best.cost else best


def _best_place(fit: Fit, reading: Placement, points: np.ndarray, centre: np.ndarray) -> Placement:
    """The best place at any height, around the trunk, from the best few of a coarse search."""
    heights = np.arange(fit.body.vertices[:, 2].min(), fit.body.vertices[:, 2].max(), HEIGHT_STEP)
    trunk = fit.body.vertices[np.abs(fit.body.vertices[:, 1]) < 0.2]
    forward = np.array([np.median(trunk[np.abs(trunk[:, 2] - h) < 0.1, 0]) for h in heights])
    middle = np.column_stack([forward, np.zeros_like(heights), heights]) - centre
    shifts = np.concatenate([middle + [ahead, 0.0, 0.0] for ahead in FORWARD_STEPS])
    starts = shifts[np.argsort(fit.cost(points + shifts[:, None]))[:STARTS]]
    shift, cost = min((fit.settled(points, start, HEIGHT_STEP) for start in starts), key=lambda found: found[1])
    return replace(reading, shift=shift, cost=cost, searched=True)


def best_scale(points: np.ndarray, body: BodySurface) -> tuple[float, float, float]:
    """Factor of `SCALES` at which points (n, 3) [m] fit best about their centre, its cost, and the cost at 1."""
    fit = Fit(body)
    tried = _some(points)
    centre = tried.mean(axis=0)
    costs = [fit.settled(scale * (tried - centre), centre, 0.02)[1] for scale in SCALES]
    return SCALES[int(np.argmin(costs))], float(min(costs)), float(fit.cost(tried))


def quarter_turns() -> list[np.ndarray]:
    """Rotations by quarters that take Z or Y up, those of `READINGS`.

    Other axes up are not tried: what hangs head down or lies on its side there would be put on by the wrong end.
    """
    turns = []
    for forward, up in READINGS:
        x, z = (np.eye(3)["XYZ".index(name[-1])] * (-1 if name[0] == "-" else 1) for name in (forward, up))
        turns.append(np.stack([x, np.cross(z, x), z]))
    return turns


def _axis(row: np.ndarray) -> str:
    index = int(np.abs(row).argmax())
    return ("-" if row[index] < 0 else "") + "XYZ"[index]
