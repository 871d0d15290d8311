"""Where a garment mesh belongs on a body: its unit, its axes and its place, found by trying.

Every reading (unit, axes, place) is judged by how closely it wraps the body. The reading that changes least wins unless
another one fits clearly better.
Dimensions: `n` vertices. Metres, root frame (X forward, Y left, Z up).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce
from itertools import permutations, product

import numpy as np
from scipy.spatial import cKDTree

from physkin_training.physics.surface_queries import BodySurface

__all__ = ["UNITS", "WORN", "Placement", "best_scale", "find_placement"]

UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
EXTENT_RANGE = (0.3, 2.5)
"""[m] a garment's longest extent."""
FAR = 0.15
"""Distance [m] beyond which a vertex is no farther from the body: skirts hang free."""
INSIDE = 4.0
"""A vertex in the body counts as if so many times as far from it."""
MOSTLY_INSIDE = 0.1
"""Share of vertices in the body from which on other places are tried."""
TRIED_POINTS = 300
CLEARLY, MUCH = 0.8, 0.6
"""Another unit or turn must cost less than this share of the simpler one; and another place less than that."""
WORN = 0.1
"""[m] largest cost of a garment that is where it is worn; the shipped ones have 0.02 to 0.08, the skirt the most."""
HEIGHT_STEP, FORWARD_STEPS = 0.03, (-0.05, 0.0, 0.05)
"""[m] of the coarse search for a place, whose best `STARTS` are settled finely."""
STARTS = 4
SCALES = (0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15)


@dataclass(frozen=True)
class Placement:
    """How to read a mesh: x = scale * turn @ file + shift. cost [m]: of `Fit.cost` there.

    unit: key of `UNITS`. turn: (3, 3) rotation by quarters. shift: (3,) [m]. searched: the shift is the closest fit,
    not one of the usual origins; then front and back of a garment that is alike on both can be mistaken.
    """

    unit: str
    turn: np.ndarray
    shift: np.ndarray
    cost: float
    searched: bool = False

    def applied(self, vertices: np.ndarray) -> np.ndarray:
        """File coordinates (n, 3) as root frame [m]."""
        return UNITS[self.unit] * vertices @ self.turn.T + self.shift

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


def find_placement(vertices: np.ndarray, body: BodySurface) -> Placement:
    """The simplest reading of vertices (n, 3), in the file's coordinates, that fits the body.

    Raises ValueError when no unit gives a garment's size.
    """
    fit = Fit(body)
    longest = float(np.ptp(vertices, axis=0).max())
    low, high = EXTENT_RANGE
    units = [unit for unit, metres in UNITS.items() if low <= longest * metres <= high]
    if not units:
        raise ValueError(
            f"the garment's longest extent is {longest:.4g} units; in {', '.join(UNITS)} it must be {low} to {high} m"
        )
    tried = vertices[np.linspace(0, len(vertices) - 1, min(TRIED_POINTS, len(vertices))).astype(int)]
    box = np.stack([vertices.min(axis=0), vertices.max(axis=0)]).mean(axis=0)
    readings = [
        (Placement(unit, turn, np.zeros(3), 0.0), *(UNITS[unit] * array @ turn.T for array in (tried, box)))
        for turn in quarter_turns()
        for unit in units
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
    tried = points[np.linspace(0, len(points) - 1, min(TRIED_POINTS, len(points))).astype(int)]
    centre = tried.mean(axis=0)
    costs = [fit.settled(scale * (tried - centre), centre, 0.02)[1] for scale in SCALES]
    return SCALES[int(np.argmin(costs))], float(min(costs)), float(fit.cost(tried))


def quarter_turns() -> list[np.ndarray]:
    """Rotations by quarters that take Z or Y up, the likely ones first: as it is, Y up (facing Z, -Z), facing -Y.

    Other axes up are not tried: what hangs head down or lies on its side there would be put on by the wrong end.
    """
    turns = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        turn = np.zeros((3, 3))
        turn[range(3), order] = signs
        if np.linalg.det(turn) > 0 and _axis(turn[2]) in ("Y", "Z"):
            turns.append(turn)
    likely = [("X", "Z"), ("Z", "Y"), ("-Z", "Y"), ("-Y", "Z")]
    names = [(_axis(turn[0]), _axis(turn[2])) for turn in turns]
    ranks = [likely.index(name) if name in likely else len(likely) for name in names]
    return [turns[index] for index in np.argsort(ranks, kind="stable")]


def _axis(row: np.ndarray) -> str:
    index = int(np.abs(row).argmax())
    return ("-" if row[index] < 0 else "") + "XYZ"[index]
