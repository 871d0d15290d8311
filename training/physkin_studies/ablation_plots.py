"""Plots of the ablations as SVG: curves on a logarithmic scale, and groups of bars."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np

__all__ = ["bars", "curves"]

COLOURS = tuple(
    "#1f6fa8 #c2571a #2d7a46 #8a3fa0 #b3261e #7a5c2e #5a5f66 #c99a00 #2aa198 #d45d9a #8fb8d6 #b7c9a8".split()
)
INK, GRID = "#444a52", "#dde0e4"
LEFT, TOP, BOTTOM, LEGEND = 62, 34, 46, 170


def curves(
    series: Mapping[str, Sequence[tuple[float, float]]],
    *,
    title: str,
    x: str,
    y: str,
    width: int = 820,
    height: int = 400,
) -> str:
    """Lines through (x, y) points by name, y logarithmic. Points without a positive y are left out.

    Raises ValueError when no point remains.
    """
    series = {name: [point for point in points if point[1] > 0] for name, points in series.items()}
    points = np.array([point for line in series.values() for point in line])
    if not len(points):
        raise ValueError("there is no point to plot")
    right, floor = width - LEGEND, height - BOTTOM
    longest = max(points[:, 0].max(), 1e-9)
    low, high = np.log10(points[:, 1].min()), np.log10(points[:, 1].max())
    high = max(high, low + 1e-6)

    def across(value: float) -> float:
        return LEFT + (right - LEFT) * value / longest

    def up(value: float) -> float:
        return floor - (floor - TOP) * (np.log10(value) - low) / (high - low)

    marks = []
    for tick in _log_ticks(low, high):
        marks.append(_line(LEFT, up(tick), right, up(tick)) + _text(LEFT - 6, up(tick) + 4, f"{tick:g}", "end"))
    for tick in _round_ticks(longest):
        marks.append(_text(across(tick), floor + 16, f"{tick:g}", "middle"))
    for index, (name, line) in enumerate(series.items()):
        colour = COLOURS[index % len(COLOURS)]
        path = " ".join(f"{across(a):.1f},{up(b):.1f}" for a, b in line)
        marks.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
        marks.append(_key(right + 12, TOP + 8 + 17 * index, name, colour))
    marks.append(
        _text((LEFT + right) / 2, height - 10, x, "middle") + _text(LEFT - 46, TOP - 10, f"{title}: {y}", "start")
    )
    return _svg(marks, width, height)


def bars(groups: Mapping[str, Mapping[str, float]], *, title: str, width: int = 820, height: int = 300) -> str:
    """Bars from zero, the groups side by side, each bar of a group by name. Raises ValueError when there is none."""
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    if not names:
        raise ValueError("there is no bar to plot")
    right, floor = width - LEGEND, height - BOTTOM - 40
    highest = max(max(group.values(), default=0.0) for group in groups.values()) or 1.0
    marks = []
    for tick in _round_ticks(highest):
        at = floor - (floor - TOP) * tick / highest
        marks.append(_line(LEFT, at, right, at) + _text(LEFT - 6, at + 4, f"{tick:g}", "end"))
    room = (right - LEFT) / len(groups)
    wide = 0.8 * room / len(names)
    for place, (label, group) in enumerate(groups.items()):
        start = LEFT + room * (place + 0.1)
        for index, name in enumerate(names):
            if name in group:
                tall = (floor - TOP) * group[name] / highest
                marks.append(
                    f'<rect x="{start + wide * index:.1f}" y="{floor - tall:.1f}" width="{0.92 * wide:.1f}" '
                    f'height="{tall:.1f}" fill="{COLOURS[index % len(COLOURS)]}"/>'
                )
        middle = start + 0.4 * room
        turned = f' transform="rotate(-25 {middle:.1f} {floor + 16})"'
        marks.append(_text(middle + 12, floor + 16, label, "end", turned))
    marks += [_key(right + 12, TOP + 8 + 17 * k, name, COLOURS[k % len(COLOURS)]) for k, name in enumerate(names)]
    marks.append(_text(LEFT - 46, TOP - 10, title, "start"))
    return _svg(marks, width, height)


def _log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 of every decade between powers of ten; both ends where there are none."""
    decades = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    ticks = [step * 10.0**decade for decade in decades for step in (1, 2, 5)]
    inside = [tick for tick in ticks if low <= np.log10(tick) <= high]
    return inside or [float(f"{10**low:.3g}"), float(f"{10**high:.3g}")]


def _round_ticks(highest: float) -> list[float]:
    """Three to seven multiples of 1, 2 or 5 times a power of ten, from 0 to at most `highest` (above 0)."""
    decade = 10.0 ** np.floor(np.log10(highest))
    step = next(step for step in (0.2 * decade, 0.5 * decade, decade, 2 * decade) if highest / step < 7)
    return [float(f"{index * step:.6g}") for index in range(int(highest / step + 1e-9) + 1)]


def _svg(marks: list[str], width: int, height: int) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'font-family="sans-serif" font-size="12" fill="{INK}"><rect width="{width}" height="{height}" fill="white"/>'
        + "\n".join(marks)
        + "</svg>\n"
    )


def _line(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{GRID}"/>'


def _text(x: float, y: float, text: str, anchor: str, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{html.escape(text)}</text>'


def _key(x: float, y: float, name: str, colour: str) -> str:
    return f'<rect x="{x}" y="{y - 9}" width="11" height="11" fill="{colour}"/>' + _text(x + 17, y, name, "start")
