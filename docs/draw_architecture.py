"""Draw `docs/architecture.svg` from the imports between rooms, as they are now; `make docs` does.

One column a package, one box a room: what it is (first sentence of its docstring) and which rooms of its package it
uses. A room uses only rooms further down.
"""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Mapping
from html import escape

from import_graph import NATIVE, ROOT, Module, modules, room_graph

DRAWING = ROOT / "docs" / "architecture.svg"
COLUMNS = {"physkin_ros": "#e3eefb", "physkin_core": "#e6f4e4", "physkin_training": "#fdeedd"}
"""Packages side by side, and the colours of their rooms."""
FOOT = ("physkin_bench", "physkin_prepare")
"""Packages drawn as one box below: those that are not installed."""
FOOT_COLOUR = "#f0f0f0"
NATIVE_SENTENCE = "The evaluator in C++ (native/), which computes a frame."

WIDTH, MARGIN, GAP, TOP = 960, 12, 28, 56
COLUMN = (WIDTH - 2 * MARGIN - 2 * GAP) / 3
LINE, LETTERS = 15, 41
"""Height of a line of text; letters that fit into one."""


def drawing() -> str:
    """The SVG, the same for the same imports and docstrings."""
    found = modules()
    graph = room_graph(found)
    for name, targets in graph.items():  # who imports a package's own `__init__` uses all that it gathers
        graph[name] = set().union(*(graph[target] if target in COLUMNS else {target} for target in targets))
    parts, bottom = [], 0.0
    for index, (package, colour) in enumerate(COLUMNS.items()):
        left, top = MARGIN + index * (COLUMN + GAP), float(TOP)
        parts.append(_text(left + COLUMN / 2, 32, package, size=17, bold=True, centred=True))
        for name in _users_first(graph, package):
            used = [_short(other) for other in sorted(graph[name]) if other.startswith(package + ".")]
            box, height = _box(left, top, COLUMN, _short(name), _sentence(found[name]), used, colour)
            parts += box
            top += height + 8
        bottom = max(bottom, top)
    for x, turn in ((MARGIN + COLUMN + 4, 1), (MARGIN + 2 * COLUMN + 2 * GAP - 4, -1)):
        parts.append(
            f'<path d="M{x} 27h{turn * (GAP - 10)}" stroke="#333" stroke-width="2.5" marker-end="url(#head)"/>'
        )
    deepest = 0
    for index, package in enumerate(FOOT):
        inside = {name for name in graph if name.split(".")[0] == package}
        used = {target.split(".")[0] for name in inside for target in graph[name] - inside}
        left = MARGIN + index * (COLUMN + GAP)
        box, height = _box(left, bottom + 8, COLUMN, package, _sentence(found[package]), sorted(used), FOOT_COLOUR)
        parts, deepest = parts + box, max(deepest, height)
    bottom = round(bottom + deepest + 2 * MARGIN)
    start = '<svg xmlns="http://www.w3.org/2000/svg" font-family="Helvetica, Arial, sans-serif"'
    head = '<marker id="head" orient="auto" markerWidth="6" markerHeight="6" refX="3" refY="3">'
    lines = (
        f'{start} viewBox="0 0 {WIDTH} {bottom}">',
        "<title>Folders of PhySkin: each uses only folders further down</title>",
        f'<defs>{head}<path d="M0 0L6 3L0 6z" fill="#333"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#fff"/>',
        *parts,
        "</svg>\n",
    )
    return "\n".join(lines)


def _users_first(graph: Mapping[str, set[str]], package: str) -> list[str]:
    """Rooms of a package, each before those it uses; its own `__init__` and `__main__` left out."""
    ordered: list[str] = []
    seen = set()

    def visit(name: str) -> None:
        if name in seen or not name.startswith(package + "."):
            return
        seen.add(name)
        for other in sorted(graph[name]):
            visit(other)
        ordered.append(name)

    for name in sorted(graph):
        visit(name)
    return [name for name in reversed(ordered) if not name.endswith("__main__")]


def _short(name: str) -> str:
    return "native" if name == NATIVE else name.partition(".")[2]


def _sentence(module: Module) -> str:
    """First sentence of what a module says of itself."""
    if module.name == NATIVE:
        return NATIVE_SENTENCE
    text = " ".join((ast.get_docstring(ast.parse(module.path.read_text())) or "").split())
    return text.partition(". ")[0].rstrip(".") + "."


def _box(left: float, top: float, width: float, name: str, sentence: str, used: list[str], colour: str):
    """A room as SVG elements, and its height."""
    letters = int(LETTERS * width / COLUMN)
    lines = textwrap.wrap(sentence.replace("`", ""), letters)
    uses = textwrap.wrap(f"uses {', '.join(used)}", letters) if used else []
    height = 25 + LINE * (len(lines) + len(uses)) + 5
    parts = [
        f'<rect x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{height}" rx="6" fill="{colour}" '
        'stroke="#8a8a8a"/>',
        _text(left + 10, top + 18, name, size=14, bold=True),
    ]
    for index, line in enumerate((*lines, *uses)):
        colour = "#222" if index < len(lines) else "#777"
        parts.append(_text(left + 10, top + 35 + LINE * index, line, size=12, colour=colour))
    return parts, height


def _text(x: float, y: float, text: str, *, size: int, bold=False, centred=False, colour="#222") -> str:
    style = (' font-weight="bold"' if bold else "") + (' text-anchor="middle"' if centred else "")
    return f'<text x="{x:.0f}" y="{y:.0f}" font-size="{size}" fill="{colour}"{style}>{escape(text)}</text>'


if __name__ == "__main__":
    DRAWING.write_text(drawing())
    print(f"wrote {DRAWING}")
