"""The one-page report of `physkin fit-garment`: verdicts, drapes, figures and losses in a single HTML file."""

from __future__ import annotations

import base64
import html
import io
import json
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.picture import CLOTH_COLOUR, Mesh, PictureError, contact_sheet, render, save_png
from physkin_training.evaluate.contact_sheet import chosen_bodies, chosen_poses, drape_all, draw
from physkin_training.evaluate.evaluate import Evaluation, evaluate_model
from physkin_training.evaluate.score_table import table
from physkin_training.fit_garment.garment_checks import CheckedGarment

__all__ = ["html_table", "loss_curve", "write_report"]

SHEET_POSES = 6
SHEET_WIDTH = 190
VIEWS = (20, 110, 200)
"""Azimuths [degrees] of the pictures at rest: front, side, back."""
COLOURS = {"ok": "#2d7a46", "repaired": "#1f6fa8", "warning": "#b36b00", "refused": "#b3261e"}
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1200px; margin: 2em auto; padding: 0 1em; color: #25282c; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; }
th, td { border-bottom: 1px solid #d8dade; padding: .35em .7em; text-align: left; vertical-align: top; }
img { max-width: 100%; } h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
.outcome { color: white; border-radius: 4px; padding: .1em .5em; } p.note { color: #5a5f66; }
"""


def write_report(
    path: Path,
    model: GarmentModel,
    checked: CheckedGarment,
    template: Avatar,
    device: torch.device,
    *,
    losses: Path,
    seconds: float,
    bodies: int,
    poses: int,
    pictures: bool,
) -> None:
    """Evaluate the model on held-out bodies and write the page; the sheet of drapes also as PNG beside it.

    losses: the training's record. seconds: how long it took. bodies, poses: see `evaluate_model`. Without the [view]
    extra the page has no pictures and says so.
    """
    scores = evaluate_model(model, device, bodies=bodies, poses=poses, seed=0, minimum=0, steps=0)
    optimisation = model.training["optimisation"]
    steps, samples = optimisation["steps"], optimisation["samples"]
    parts = [
        f"<h1>{html.escape(model.name)}</h1>",
        f"<p>{len(model.garment.vertices)} vertices, {len(model.node_rest)} garment nodes; trained for "
        f"{seconds / 60:.1f} minutes ({steps} steps of {samples} poses) on {html.escape(device.type)}.</p>",
        "<h2>The mesh</h2>",
        _verdicts(checked),
    ]
    shown: list[str] = []
    if pictures:
        try:
            sheet = _sheet(model, device)
            save_png(path.with_suffix(".png"), sheet)
            shown = [_image(_at_rest(checked, template)), _image(sheet)]
        except PictureError as error:
            parts.append(f'<p class="note">No pictures: {html.escape(str(error))}</p>')
    if shown:
        parts += ["<p>As it was trained, on the template's body:</p>", shown[0], "<h2>Drapes</h2>"]
        parts += [
            '<p class="note">Bodies that training has not seen; poses uniform in the joint limits and frames of '
            "motion. Percent: mean edge strain.</p>",
            shown[1],
        ]
    parts += ["<h2>Figures</h2>", html_table(table(scores)), "<h2>Training</h2>", loss_curve(_read_losses(losses))]
    page = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(model.name)}</title>'
    path.write_text(f"{page}<style>{STYLE}</style><body>\n" + "\n".join(parts) + "\n</body></html>\n", encoding="utf-8")


def _verdicts(checked: CheckedGarment) -> str:
    rows = ["<tr><th>check</th><th>verdict</th><th>found</th><th>allowed</th></tr>"]
    for verdict in checked.verdicts:
        badge = f'<span class="outcome" style="background:{COLOURS[verdict.outcome]}">{verdict.outcome}</span>'
        check, found, allowed = map(html.escape, (verdict.check, verdict.found, verdict.allowed))
        rows.append(f"<tr><td>{check}</td><td>{badge}</td><td>{found}</td><td>{allowed}</td></tr>")
    return "<table>" + "\n".join(rows) + "</table>"


def html_table(markdown: str) -> str:
    """A Markdown table, without columns that are empty, and the lines after it as HTML."""
    lines = markdown.splitlines()
    after = [line for line in lines if not line.startswith("|")]
    cells = [line[1:-1].split("|") for line in lines if line.startswith("|") and not line.startswith("|---")]
    filled = [column for column in zip(*cells) if any(cell.strip() for cell in column[1:])]
    rows = []
    for row in zip(*filled):
        kind = "td" if rows else "th"
        rows.append("<tr>" + "".join(f"<{kind}>{html.escape(cell.strip())}</{kind}>" for cell in row) + "</tr>")
    notes = "".join(f"<p>{html.escape(line)}</p>" for line in after if line)
    return "<table>" + "\n".join(rows) + "</table>" + notes


def loss_curve(rows: list[dict], *, width: int = 760, height: int = 220) -> str:
    """Median stretch and contact energy over the steps as an SVG, logarithmic; a note instead when there is too little.

    rows: of the training's `losses.jsonl`.
    """
    points = [(row["step"], row["median_stretch_and_collision"]) for row in rows]
    points = [(step, energy) for step, energy in points if energy > 0]
    if len(points) < 2:
        return '<p class="note">Too short a run for a curve.</p>'
    steps, energies = (np.array(column, dtype=float) for column in zip(*points))
    logs = np.log10(energies)
    span = max(float(np.ptp(logs)), 1e-6)
    x = 60 + (width - 80) * (steps - steps[0]) / (steps[-1] - steps[0])
    y = 10 + (height - 40) * (logs.max() - logs) / span
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y))
    labels = [(energies.max(), 14), (energies.min(), height - 28)]
    texts = "".join(f'<text x="52" y="{at}" text-anchor="end">{value:.3g} J</text>' for value, at in labels)
    texts += f'<text x="{width - 20}" y="{height - 8}" text-anchor="end">step {steps[-1]:.0f}</text>'
    return (
        "<p>Stretch and contact energy of the median pose; it rises while the poses' range grows.</p>"
        f'<svg width="{width}" height="{height}" font-size="11" fill="#5a5f66">{texts}'
        f'<polyline points="{line}" fill="none" stroke="#1f6fa8" stroke-width="1.5"/></svg>'
    )


def _read_losses(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def _at_rest(checked: CheckedGarment, template: Avatar) -> np.ndarray:
    meshes = [Mesh(template.vertices, template.faces), Mesh(checked.vertices, checked.faces, CLOTH_COLOUR)]
    return contact_sheet([render(meshes, size=(300, 375), azimuth=view) for view in VIEWS], columns=len(VIEWS))


def _sheet(model: GarmentModel, device: torch.device) -> np.ndarray:
    bodies = chosen_bodies(load_body_model())
    evaluation = Evaluation(model, device, bodies=list(bodies.values()), poses=SHEET_POSES, seed=0)
    poses, names = chosen_poses(model.rig, count=SHEET_POSES, seed=0)
    drapes = drape_all(evaluation, poses, minimum=False)
    captions = [f"{name}, {body}" for name in names for body in bodies]
    gravity = poses.gravity.numpy().repeat(len(bodies), axis=0)
    return draw(drapes, model, gravity, captions, columns=2 * len(bodies), width=SHEET_WIDTH)


def _image(picture: np.ndarray) -> str:
    buffer = io.BytesIO()
    save_png(buffer, picture)
    return f'<img src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}" alt="">'
