"""The HTML page of a replayed bag: figures, plots over time and a few pictures, in one file that loads nothing else.

Dimensions: `T` clouds, `n` garment vertices. Plots are inline SVG, pictures embedded PNG.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core import Draper
from physkin_core.picture import CLOTH_COLOUR, Mesh, PictureError, render
from physkin_ros.replay.figures import LABELS

if TYPE_CHECKING:
    from physkin_ros.replay.replay import Replay

__all__ = ["thumbnails", "write_report"]

PICTURE_SIZE = (240, 320)
PLOT_WIDTH, PLOT_HEIGHT = 860, 150
LEFT, RIGHT, TOP, BOTTOM = 56, 10, 10, 22  # [pixels] around a plot's frame
BINS = 400  # a longer series is drawn as the range and mean of as many stretches

PLOTS = (
    ("Edge strain [%]", "time_s", (("edge_strain_percent", "model"),)),
    ("Area strain [%]", "time_s", (("area_strain_percent", "model"),)),
    ("Jitter: mean second difference [mm]", "time_s", (("jitter_mm", "model"), ("jitter_skinning_mm", "skinning"))),
    ("Vertices inside the body [%]", "contact_time_s", (("inside_percent", "model"),)),
    ("Deepest penetration [mm]", "contact_time_s", (("max_depth_mm", "model"),)),
    ("Evaluator [µs]", "time_s", (("latency_us", "model"),)),
)
"""Title, series of times, series drawn with their style."""

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #23272e; max-width: 900px; margin: 2em auto; padding: 0 1em }
h1 { font-size: 1.4em } h2 { font-size: 1.05em; margin: 1.6em 0 .3em }
table { border-collapse: collapse } td, th { padding: .15em .9em .15em 0; text-align: left; vertical-align: top }
td.number { text-align: right; font-variant-numeric: tabular-nums }
figure { display: inline-block; margin: 0 .4em .6em 0 } figcaption { font-size: .85em; color: #667 }
svg { display: block; max-width: 100% } svg text { font: 11px system-ui, sans-serif; fill: #667 }
.frame { fill: none; stroke: #ccd } .grid { stroke: #e8eaee }
.model { stroke: #29668f; fill: none } .skinning { stroke: #c0803a; fill: none }
.range.model { fill: #29668f; stroke: none; opacity: .22 } .range.skinning { fill: #c0803a; stroke: none; opacity: .22 }
.worse { color: #a3261b } .well { color: #2c6e3f }
"""


def thumbnails(found: Replay, draper: Draper, *, count: int) -> tuple[list[tuple[str, bytes]], str]:
    """Up to `count` pictures of body and garment, spread over the bag, gravity pointing down: caption and PNG each.

    Also a remark for the page: empty, or why there are none.
    """
    if count == 0:
        return [], ""
    chosen = np.unique(np.linspace(0, len(found.frames) - 1, count).round().astype(int))
    scenes = []
    for row in chosen:
        cloth = draper.drape(found.positions[row], found.gravity[row])[:, :3]
        body = draper.avatar.posed_vertices(draper.bone_transforms(found.positions[row]))
        down = found.gravity[row] / np.linalg.norm(found.gravity[row])
        upright = Rotation.align_vectors([[0.0, 0.0, -1.0]], [down])[0]
        scenes.append((upright.apply(body), upright.apply(cloth)))
    drawn = np.concatenate([points for scene in scenes for points in scene])
    bounds = np.stack([drawn.min(axis=0), drawn.max(axis=0)])
    pictures = []
    try:
        for row, (body, cloth) in zip(chosen, scenes):
            meshes = [Mesh(body, draper.avatar.faces), Mesh(cloth, draper.faces, CLOTH_COLOUR)]
            seconds = (found.times_ns[row] - found.times_ns[0]) / 1e9
            pictures.append((f"{seconds:.2f} s", _png(render(meshes, bounds=bounds, size=PICTURE_SIZE))))
    except PictureError as error:
        return [], f"No pictures: {error}"
    return pictures, ""


def write_report(
    path: Path,
    figures: Mapping,
    pictures: Sequence[tuple[str, bytes]] = (),
    remark: str = "",
    worse: Sequence[str] | None = None,
) -> None:
    """Write the page. figures: from `describe`. pictures, remark: from `thumbnails`. worse: from `regressions`, None
    when there is no baseline."""
    bag, run = figures["bag"], figures["run"]
    title = f"{run['model']} on {run['avatar']}, replayed from {bag['name']}"
    parts = [f"<h1>{html.escape(title)}</h1>", _verdict(worse), _counts_table(figures), _figures_table(figures)]
    images = [(html.escape(caption), base64.b64encode(png).decode("ascii")) for caption, png in pictures]
    parts += [
        f'<figure><img src="data:image/png;base64,{png}" width="{PICTURE_SIZE[0]}" alt="garment at {caption}">'
        f"<figcaption>{caption}</figcaption></figure>"
        for caption, png in images
    ]
    if remark:
        parts.append(f"<p>{html.escape(remark)}</p>")
    for name, times, lines in PLOTS:
        series = figures["series"]
        drawn = [(series[line], style) for line, style in lines]
        if any(value is not None for values, _ in drawn for value in values):
            note = " (plain skinning in orange)" if len(lines) > 1 else ""
            parts.append(f"<h2>{html.escape(name)}{note}</h2>{_plot(series[times], drawn)}")
    page = f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
    path.write_text(page + f"<style>{STYLE}</style>\n" + "\n".join(filter(None, parts)) + "\n</html>\n", "utf-8")


def _verdict(worse: Sequence[str] | None) -> str:
    if worse is None:
        return ""
    if not worse:
        return '<p class="well">Not worse than the baseline.</p>'
    return '<p class="worse">Worse than the baseline:<br>' + "<br>".join(map(html.escape, worse)) + "</p>"


def _counts_table(figures: Mapping) -> str:
    counts, bag, run = figures["counts"], figures["bag"], figures["run"]
    rate = f", {bag['rate_hz']:.1f} Hz" if bag["rate_hz"] else ""
    rows = {
        "joint states": f"{counts['joint_states']} on {bag['topic']}, {bag['duration_s']:.2f} s{rate}",
        "draped": f"{counts['draped']}",
        "rejected": f"{counts['rejected']}",
        "gravity": f"{counts['gravity_messages']} messages, {counts['gravity_rejected']} rejected",
        "evaluator": f"{run['backend']}, {run['instruction_set']}, {run['vertices']} vertices",
    }
    if counts["out_of_range_clouds"]:
        joints = ", ".join(f"{name} ({count})" for name, count in list(figures["out_of_range"].items())[:6])
        rows["beyond joint limits"] = f"{counts['out_of_range_clouds']} clouds: {joints}"
    rows |= {f"rejected {count} times": reason for reason, count in figures["reasons"].items()}
    lines = (f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>" for name, value in rows.items())
    return f"<table>{''.join(lines)}</table>"


def _figures_table(figures: Mapping) -> str:
    kinds = ("mean", "p50", "p95", "p99", "max")
    rows = {label: figures["figures"][name] for name, label in LABELS.items()}
    rows["evaluator [us]"] = figures["latency_us"]
    lines = ["<tr><th></th>" + "".join(f"<th>{kind}</th>" for kind in kinds) + "</tr>"]
    for label, spread in rows.items():
        cells = ("" if spread.get(kind) is None else f"{spread[kind]:.3f}" for kind in kinds)
        lines.append(f"<tr><td>{label}</td>" + "".join(f'<td class="number">{cell}</td>' for cell in cells) + "</tr>")
    return f"<h2>Figures</h2><table>{''.join(lines)}</table>"


def _plot(times: Sequence[float], lines: Sequence[tuple[Sequence[float | None], str]]) -> str:
    """An SVG of series over time [s]; None is a gap."""
    x = np.array(times, dtype=float)
    series = [(np.array([math.nan if v is None else v for v in values]), style) for values, style in lines]
    highest = max(float(np.nanmax(values)) for values, _ in series if np.isfinite(values).any()) or 1.0
    last = float(x[-1]) or 1.0
    width, height = PLOT_WIDTH - LEFT - RIGHT, PLOT_HEIGHT - TOP - BOTTOM
    marks = []
    for value in _ticks(highest):
        y = TOP + height * (1 - value / highest)
        marks.append(f'<path class="grid" d="M{LEFT} {y:.1f}h{width}"/>')
        marks.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    for value in _ticks(last):
        place = LEFT + width * value / last
        marks.append(f'<text x="{place:.1f}" y="{PLOT_HEIGHT - 6}" text-anchor="middle">{value:g} s</text>')
    for values, style in series:
        bins = np.minimum((x / last * BINS).astype(int), BINS - 1) if len(x) > 2 * BINS else np.arange(len(x))
        upper, lower, line = [], [], []
        for each in np.unique(bins):
            here = values[bins == each]
            here = here[np.isfinite(here)]
            place = LEFT + width * float(x[bins == each].mean()) / last
            if len(here):
                low, middle, high = (TOP + height * (1 - v / highest) for v in (here.min(), here.mean(), here.max()))
                line.append(f"{place:.1f} {middle:.1f}")
                lower.append(f"{place:.1f} {low:.1f}")
                upper.append(f"{place:.1f} {high:.1f}")
        if len(x) > 2 * BINS:
            marks.append(f'<path class="range {style}" d="M{"L".join(upper + lower[::-1])}Z"/>')
        if line:
            marks.append(f'<path class="{style}" d="M{"L".join(line)}"/>')
    frame = f'<rect class="frame" x="{LEFT}" y="{TOP}" width="{width}" height="{height}"/>'
    return f'<svg viewBox="0 0 {PLOT_WIDTH} {PLOT_HEIGHT}" width="{PLOT_WIDTH}">{"".join(marks)}{frame}</svg>'


def _ticks(highest: float) -> list[float]:
    """Round values from 0 up to `highest`, about four."""
    step = 10 ** math.floor(math.log10(highest / 4))
    step *= next(factor for factor in (1, 2, 5, 10) if highest / (factor * step) <= 5)
    return [round(k * step, 12) for k in range(int(highest / step + 1e-9) + 1)]


def _png(image: np.ndarray) -> bytes:
    from physkin_core.picture import save_png

    buffer = io.BytesIO()
    save_png(buffer, image)
    return buffer.getvalue()
