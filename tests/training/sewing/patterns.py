"""Small sewing patterns, as files."""

from __future__ import annotations

import json
from pathlib import Path


def panel(corners: list, *, place: tuple = (0, 0, 0), turn: tuple = (0, 0, 0), bends: dict | None = None) -> dict:
    """With straight edges but for `bends`, by index of the edge."""
    count = len(corners)
    edges = [{"endpoints": [k, (k + 1) % count]} for k in range(count)]
    for index, bend in (bends or {}).items():
        edges[index]["curvature"] = bend
    return {"vertices": corners, "edges": edges, "translation": list(place), "rotation": list(turn), "label": "body"}


def sides(*pairs: tuple) -> list:
    """Stitches of (panel, edge, panel, edge)."""
    return [[{"panel": a, "edge": i}, {"panel": b, "edge": j}] for a, i, b, j in pairs]


def buttons(*pairs: tuple) -> list:
    """Closures of (panel, x, y, panel, x, y)."""
    return [[{"panel": a, "at": [x, y]}, {"panel": b, "at": [u, v]}] for a, x, y, b, u, v in pairs]


def tube_skirt(*, width: float = 60.0, length: float = 50.0, waist: float = 60.0, gather: float = 1.0) -> dict:
    """Two panels [cm] before and behind the hips, sewn at both sides; the back is drawn from inside, as patterns do.
    waist: width of the upper edge. gather: the back's side edges are so much longer."""
    left, right = (width - waist) / 2, (width + waist) / 2
    front = panel([[0, 0], [width, 0], [right, length], [left, length]], place=(-width / 2, 50, 25))
    back = panel([[0, 0], [left, length * gather], [right, length * gather], [width, 0]], place=(-width / 2, 50, -25))
    return {
        "pattern": {
            "panels": {"front": front, "back": back},
            "stitches": sides(("front", 1, "back", 2), ("front", 3, "back", 0)),
        },
        "properties": {"units_in_meter": 100, "curvature_coords": "relative"},
    }


def written(folder: Path, pattern: object) -> Path:
    """The file of a pattern."""
    path = folder / "pattern.json"
    path.write_text(pattern if isinstance(pattern, str) else json.dumps(pattern))
    return path
