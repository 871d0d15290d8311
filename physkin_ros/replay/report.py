"""The HTML page of a replayed bag: figures, plots over time and a few pictures, in one file that loads nothing else.

Dimensions: `T` clouds, `n` garment vertices. Plots and pictures are embedded PNG and need the extra `[view]`.
"""

from __future__ import annotations

import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
from scipy.spatial.transform import Rotation
from tabulate import tabulate

from physkin_core import Draper
from physkin_core.extras import install_command
from physkin_core.html_page import image, write_page
from physkin_core.pictures.picture import PictureError, render, save_png
from physkin_core.render.filming import dressed_meshes
from physkin_ros.replay.figures import LABELS, summary
from physkin_ros.replay.replay import Replay

__all__ = ["overview", "thumbnails", "write_report"]

PICTURES, PICTURE_SIZE = 6, (240, 320)
PLOTS = {
    "Edge strain [%]": ("edge_strain_percent",),
    "Area strain [%]": ("area_strain_percent",),
    "Jitter: mean second difference [mm]; dotted: plain skinning": ("jitter_mm", "jitter_skinning_mm"),
    "Vertices inside the body [%]": ("inside_percent",),
    "Deepest penetration [mm]": ("max_depth_mm",),
    "Evaluator [µs]": ("latency_us",),
}
"""Title -> series drawn."""


def thumbnails(found: Replay, draper: Draper) -> tuple[list[tuple[str, bytes]], str]:
    """Pictures of body and garment, spread over the bag, gravity pointing down: caption and PNG each.

    Also a remark for the page: empty, or why there are none.
    """
    kept = list(found.kept)
    if not kept:
        return [], ""
    chosen = [kept[k] for k in np.unique(np.linspace(0, len(kept) - 1, PICTURES).round().astype(int))]
    scenes = []
    for row in chosen:
        upright = Rotation.align_vectors([[0.0, 0.0, -1.0]], [found.down[row]])[0]
        shown = draper.outfit.posed_body(found.positions[row]), found.kept[row][:, :3].astype(np.float64)
        scenes.append([upright.apply(points) for points in shown])
    drawn = np.concatenate([points for scene in scenes for points in scene])
    bounds = np.stack([drawn.min(axis=0), drawn.max(axis=0)])
    pictures = []
    try:
        for row, (body, cloth) in zip(chosen, scenes):
            png = io.BytesIO()
            save_png(png, render(dressed_meshes(draper.outfit, body, [cloth]), bounds=bounds, size=PICTURE_SIZE))
            pictures.append((f"{(found.times_ns[row] - found.times_ns[0]) / 1e9:.2f} s", png.getvalue()))
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
    title = f"{figures['run']['model']} on {figures['run']['avatar']}, replayed from {figures['bag']['name']}"
    parts = []
    if worse:
        parts.append(f'<p class="worse">Worse than the baseline:<br>{"<br>".join(map(html.escape, worse))}</p>')
    elif worse is not None:
        parts.append('<p class="well">Not worse than the baseline.</p>')
    parts.append(summary(figures, "html"))
    for caption, png in pictures:
        shown = image(png, f"garment at {caption}")
        parts.append(f"<figure>{shown}<figcaption>{html.escape(caption)}</figcaption></figure>")
    write_page(path, title, "\n".join([*parts, f"<p>{html.escape(remark)}</p>", _plots(figures["series"])]))


def overview(bags: Sequence[tuple[str, str, Mapping | None]]) -> str:
    """A table of many bags, HTML. bags: of each its name, the address of its own page, and its figures from `describe`,
    None while there are none."""
    rows = []
    for name, address, figures in bags:
        cells = [html.escape(name)]
        if figures:
            counts, means = figures["counts"], [figures["figures"][figure]["mean"] for figure in LABELS]
            link = f'<a href="{quote(address)}">{html.escape(name)}</a>'
            cells = [link, counts["draped"], counts["rejected"], figures["bag"]["duration_s"], *means]
        rows.append(cells)
    header, formats = ["bag", "draped", "rejected", "s", *LABELS.values()], ["", "", "", ".2f", *[".3f"] * len(LABELS)]
    return f"<p>Means over clouds.</p>\n{tabulate(rows, header, 'unsafehtml', floatfmt=formats, missingval='')}"


def _plots(series: Mapping[str, Sequence[float | None]]) -> str:
    """All series that hold anything, over time [s], one below the other; None is a gap."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return f"<p>No plots: they need matplotlib: {install_command('view')}</p>"
    drawn = {title: names for title, names in PLOTS.items() if any(value is not None for value in series[names[0]])}
    figure = Figure(figsize=(9, 1.7 * len(drawn)), layout="constrained")
    for axes, (title, names) in zip(figure.subplots(len(drawn), sharex=True, squeeze=False)[:, 0], drawn.items()):
        for name, style in zip(names, ("-", ":")):
            values = np.array(series[name], dtype=float)
            times = series["time_s"] if len(values) == len(series["time_s"]) else series["contact_time_s"]
            axes.plot(times, values, style, linewidth=1)
        axes.set_title(title, loc="left", fontsize="medium")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    png = io.BytesIO()
    figure.savefig(png, format="png")
    return image(png.getvalue(), "plots over time [s]")
