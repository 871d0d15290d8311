"""The one-page report of `physkin fit-garment`: verdicts, drapes, figures and losses in a single HTML file."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from tabulate import tabulate

from physkin_core.avatar.avatar import Avatar
from physkin_core.check.garment_check import check_garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.outfit.draper import Draper
from physkin_core.pictures.picture import CLOTH_COLOUR, Mesh, PictureError, contact_sheet, render, save_png
from physkin_core.render.filming import avatar_mesh, dressed_meshes
from physkin_training.evaluate.contact_sheet import chosen_poses, draw_sheet
from physkin_training.evaluate.evaluate import evaluate_model
from physkin_training.evaluate.score_table import table
from physkin_training.fit_garment.checks import CheckedGarment
from physkin_training.fit_garment.own_pose import OwnPose
from physkin_training.fit_garment.training_record import (
    learnt,
    longer_or_not,
    loss_curve,
    read_losses,
    taken_over,
    undertrained,
)
from physkin_training.fit_garment.verdicts import COLUMNS, Verdict
from physkin_training.time_budget import TimeBudget

__all__ = [
    "badge",
    "front_and_back",
    "html_page",
    "html_table",
    "placement_picture",
    "write_report",
]

FIRST_POSES = 2
"""Poses a body that are evaluated first, to see how many there is time for."""
PICTURE_SECONDS = 30.0
"""The first pictures, with what they load and compile."""
SHEET_POSES = 6
AVATAR_POSES = 2
VIEWS = (20, 110, 200)
"""Azimuths [degrees] of the pictures at rest: front, side, back."""
COLOURS = {"ok": "#2d7a46", "repaired": "#1f6fa8", "warning": "#b36b00", "unsure": "#7a4fa3", "refused": "#b3261e"}
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1200px; margin: 2em auto; padding: 0 1em; color: #25282c; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; }
th, td { border-bottom: 1px solid #d8dade; padding: .35em .7em; text-align: left; vertical-align: top; }
img { max-width: 100%; } h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
.outcome { color: white; border-radius: 4px; padding: .1em .5em; } p.note { color: #5a5f66; }
"""
RULER = set("|:-")
"""Of which the second line of a Markdown table is made."""
FRONT_AND_BACK = (20, 200)
"""Azimuths [degrees] of a garment at rest before training."""
SIZE = (330, 290)
"""Pixels of one of these."""


def write_report(
    path: Path,
    model: GarmentModel,
    checked: CheckedGarment,
    template: Avatar,
    avatar: Avatar | None,
    device: torch.device,
    budget: TimeBudget,
    *,
    losses: Path,
    sway: str,
    seconds: float,
    bodies: int,
    poses: int,
) -> dict:
    """Evaluate the model on held-out bodies and write the page; the sheet of drapes also as PNG beside it. Returns the
    figures, of `evaluate_model`.

    avatar: the user's own body, draped too; None for none. losses: the training's record. sway: how it learnt to sway,
    in words, "" where it did not try. seconds: how long training took. bodies, poses: see `evaluate_model`; there are
    fewer poses and pictures where the budget has no time for all.
    Without the [view] extra the page has no pictures and says so.
    """

    def evaluate(count: int) -> dict:
        return evaluate_model(model, device, bodies=bodies, poses=count)

    worn = None if avatar is None else Draper(model, avatar)
    few = min(FIRST_POSES, poses)
    scores, taken = budget.timed(lambda: evaluate(few))
    shown = _pictures(path, model, checked, template, worn, device, budget)
    more = int(min(poses, few * budget.left / taken))
    if more > few:
        scores = evaluate(more)
    optimisation, rows = model.training["optimisation"], read_losses(losses)
    steps, samples = rows[-1]["step"] if rows else optimisation["steps"], optimisation["samples"]
    too_short = undertrained(scores, steps, begun="started_from" in model.training)
    counts = "{bodies} held-out bodies, {poses} poses each".format(**scores["counts"])
    parts = [
        f"<h1>{html.escape(model.name)}</h1>",
        f"<p>{len(model.garment.vertices)} vertices, {len(model.node_rest)} garment nodes; trained for "
        f"{seconds / 60:.1f} minutes, to step {steps} of {optimisation['steps']} of {samples} poses each, on "
        f"{html.escape(device.type)}.</p>",
        "<h2>In short</h2>",
        *([f"<p>{badge('undertrained', 'warning')} {html.escape(too_short)}</p>"] if too_short else []),
        _in_short(scores, model, rows, sway),
        "<h2>The mesh</h2>",
        _verdicts(checked),
        *([] if worn is None else [_how_it_sits(worn)]),
        *shown,
        f"<h2>Figures</h2><p>{counts}.</p>",
        html_table(table(scores)),
        "<h2>Training</h2>",
        loss_curve(rows),
    ]
    path.write_text(html_page(model.name, parts), encoding="utf-8")
    return scores


def html_page(title: str, parts: Sequence[str], *, head: str = "") -> str:
    """A whole page in this project's style. parts: its body, HTML. head: more of its head, HTML."""
    page = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>{head}'
    return f"{page}<style>{STYLE}</style><body>\n" + "\n".join(parts) + "\n</body></html>\n"


def badge(text: str, outcome: str) -> str:
    """A word in the colour of an outcome of a check, HTML."""
    return f'<span class="outcome" style="background:{COLOURS[outcome]}">{html.escape(text)}</span>'


def _pictures(
    path: Path,
    model: GarmentModel,
    checked: CheckedGarment,
    template: Avatar,
    worn: Draper | None,
    device: torch.device,
    budget: TimeBudget,
) -> list[str]:
    late = f"there was no time for {{}}: physkin contact-sheet {path.with_suffix('.safetensors').name} draws drapes"
    if budget.left < PICTURE_SECONDS:
        return [_note(late.format("them"))]
    try:
        rest, taken = budget.timed(lambda: _at_rest(checked, template))  # three renderings, larger than a pose's three
        poses = int(min(SHEET_POSES, budget.left / 2 / taken))
        parts = ["<p>As it was trained, on the template's body:</p>", _image(rest), "<h2>Drapes</h2>"]
        if worn is not None and budget.left > 3 * taken:
            parts += ["<p>On your avatar, in the poses of the first rows:</p>", _image(_on_avatar(worn))]
        if poses < 1:
            return [*parts, _note(late.format("a sheet"))]
        sheet, _ = draw_sheet(model, device, poses=poses)
    except PictureError as error:
        return [_note(str(error))]
    save_png(path.with_suffix(".png"), sheet)
    said = "Bodies that training has not seen; poses uniform in the joint limits and frames of motion. Percent: mean "
    return [*parts, f'<p class="note">{said}edge strain.</p>', _image(sheet)]


def _note(text: str) -> str:
    return f'<p class="note">No pictures: {html.escape(text)}</p>'


def _in_short(scores: dict, model: GarmentModel, rows: list[dict], sway: str) -> str:
    """How good the model is, what it began with, what it learnt and whether longer would help: a list."""
    drape, plain = scores["model"], scores["skinning"]
    good = (
        f"In any pose that the joints allow, edges of the cloth are {drape['edge_strain_percent']:.1f} % longer or "
        f"shorter than at rest on average ({plain['edge_strain_percent']:.1f} % where cloth only follows the bones), "
        f"and {drape['inside_percent']:.1f} % of its vertices are inside the body. In everyday poses it is less."
    )
    begun = taken_over(model.training, sways=model.sway is not None, own_sway=sway)
    said = (good, begun, learnt(model.training, rows), longer_or_not(rows))
    return "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in said) + "</ul>"


def _verdicts(checked: CheckedGarment) -> str:
    """What was found or mended; below, folded up, the checks that found nothing."""

    def rows(verdicts: Sequence[Verdict]) -> str:
        cells = [
            [html.escape(verdict.check), badge(verdict.outcome, verdict.outcome)]
            + [html.escape(text) for text in (verdict.found, verdict.allowed)]
            for verdict in verdicts
        ]
        return tabulate(cells, COLUMNS, tablefmt="unsafehtml")

    ok = [verdict for verdict in checked.verdicts if verdict.outcome == "ok"]
    others = [verdict for verdict in checked.verdicts if verdict.outcome != "ok"]
    shown = rows(others) if others else ""
    return f"{shown}<details><summary>{len(ok)} checks found nothing amiss</summary>{rows(ok)}</details>"


def html_table(markdown: str) -> str:
    """A Markdown table, without columns that are empty, and the lines after it as HTML."""
    lines = markdown.splitlines()
    cells = [line[1:-1].split("|") for line in lines if line.startswith("|") and not set(line) <= RULER]
    filled = [column for column in zip(*cells) if any(cell.strip() for cell in column[1:])]
    header, *rows = ([cell.strip() for cell in row] for row in zip(*filled))
    notes = "".join(f"<p>{html.escape(line)}</p>" for line in lines if line and not line.startswith("|"))
    return tabulate(rows, header, tablefmt="html", disable_numparse=True) + notes


def _how_it_sits(worn: Draper) -> str:
    """What `physkin check` finds on the user's avatar."""
    return f"<h2>On your avatar</h2><p>{html.escape(str(check_garment(worn.layer, worn.avatar)))}.</p>"


def _on_avatar(worn: Draper) -> np.ndarray:
    """The garment on the user's avatar in `AVATAR_POSES` poses, front and back."""
    poses, names = chosen_poses(worn.model.rig, count=AVATAR_POSES, seed=0)
    images = []
    for positions, gravity in zip(poses.positions.numpy(), poses.gravity.numpy()):
        garment = worn.drape(positions, gravity)[:, :3]
        images += front_and_back(dressed_meshes(worn.outfit, worn.outfit.posed_body(positions), [garment]))
    return contact_sheet(
        images, columns=4, captions=[f"{name}, {side}" for name in names for side in ("front", "back")]
    )


def _at_rest(checked: CheckedGarment, template: Avatar) -> np.ndarray:
    meshes = [Mesh(template.vertices, template.faces), Mesh(checked.vertices, checked.faces, CLOTH_COLOUR)]
    return contact_sheet([render(meshes, size=(300, 375), azimuth=view) for view in VIEWS], columns=len(VIEWS))


def _image(picture: np.ndarray) -> str:
    buffer = io.BytesIO()
    save_png(buffer, picture)
    return f'<img src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}" alt="">'


def placement_picture(
    checked: CheckedGarment, avatar: Avatar, template: Avatar | None, own: OwnPose | None
) -> np.ndarray:
    """Front and back, (h, w, 3) uint8: on the avatar as the garment lies there, below on the template as it is trained.

    template: None for a garment whose place is in doubt, which was not carried there. own: the avatar in its own pose,
    None where no avatar was given; one of the two is there. Raises PictureError without the [view] extra.
    """
    images, captions = [], []
    if own is not None:
        body = own.vertices if checked.in_own_pose else avatar.vertices
        images += front_and_back([avatar_mesh(avatar, body), Mesh(checked.lying, checked.faces, CLOTH_COLOUR)])
        place = "as it lies" if checked.in_own_pose else "where it was placed"
        captions += [f"on the avatar, {place}", "back"]
    if template is not None:
        cloth = Mesh(checked.vertices, checked.faces, CLOTH_COLOUR)
        images += front_and_back([avatar_mesh(template, template.vertices), cloth])
        captions += ["on the template, as it is trained", "back"]
    return contact_sheet(images, columns=2, captions=captions)


def front_and_back(meshes: Sequence[Mesh]) -> list[np.ndarray]:
    """Two pictures of a body and what it wears."""
    return [render(meshes, size=SIZE, azimuth=azimuth, samples=8) for azimuth in FRONT_AND_BACK]
