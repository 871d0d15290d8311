"""The one-page report of `physkin fit-garment`: verdicts, drapes, figures and losses in a single HTML file."""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from pathlib import Path
from string import Template

import numpy as np
import torch
from tabulate import tabulate

from physkin_core.avatar.avatar import Avatar
from physkin_core.check.garment_check import check_garment
from physkin_core.html_page import badge, image, write_page
from physkin_core.model.garment_model import GarmentModel
from physkin_core.outfit.draper import Draper
from physkin_core.pictures.picture import PictureError, save_png
from physkin_training.evaluate.contact_sheet import draw_sheet
from physkin_training.evaluate.evaluate import evaluate_model
from physkin_training.evaluate.score_table import remarks, table_cells
from physkin_training.fit_garment.checks import CheckedGarment
from physkin_training.fit_garment.pictures import at_rest, worn_in_two_poses
from physkin_training.fit_garment.training_record import TrainingRecord, learnt, taken_over
from physkin_training.fit_garment.verdicts import COLUMNS, Verdict
from physkin_training.time_budget import TimeBudget

__all__ = ["write_report"]

FIRST_POSES = 2
"""Poses a body that are evaluated first, to see how many there is time for."""
PICTURE_SECONDS = 30.0
"""The first pictures, with what they load and compile."""
SHEET_POSES = 6
BODY = Template("""<p>$vertices vertices, $nodes garment nodes; trained for $minutes minutes,
to step $steps of $all_steps of $samples poses each, on $device.</p>
<h2>In short</h2>
$undertrained
$in_short
<h2>The mesh</h2>
$verdicts
$how_it_sits
$pictures
<h2>Figures</h2><p>$counts.</p>
$figures
<h2>Training</h2>
$curve""")


def write_report(
    output: Path,
    model: GarmentModel,
    checked: CheckedGarment,
    template: Avatar,
    avatar: Avatar | None,
    device: torch.device,
    budget: TimeBudget,
    *,
    record: TrainingRecord,
    sway: str,
    seconds: float,
    bodies: int,
    poses: int,
) -> dict:
    """Evaluate the model of a file on held-out bodies and write the page beside it; the sheet of drapes also as PNG.
    Returns the figures, of `evaluate_model`.

    avatar: the user's own body, draped too; None for none. sway: how it learnt to sway, in words, "" where it did not
    try. seconds: how long training took. bodies, poses: see `evaluate_model`; there are fewer poses and pictures where
    the budget has no time for all.
    Without the [view] extra the page has no pictures and says so.
    """

    def evaluate(count: int) -> dict:
        return evaluate_model(model, device, bodies=bodies, poses=count)

    worn = None if avatar is None else Draper(model, avatar)
    few = min(FIRST_POSES, poses)
    scores, taken = budget.timed(lambda: evaluate(few))
    pictures = "\n".join(_pictures(output, model, checked, template, worn, device, budget))
    more = int(min(poses, few * budget.left / taken))
    if more > few:
        scores = evaluate(more)
    how_it_sits = ""
    if worn is not None:
        found = html.escape(str(check_garment(worn.layer, worn.avatar)))
        how_it_sits = f"<h2>On your avatar</h2><p>{found}.</p>"
    optimisation = model.training["optimisation"]
    undertrained = record.undertrained(scores, begun="started_from" in model.training)
    body = BODY.substitute(
        vertices=len(model.garment.vertices),
        nodes=len(model.node_rest),
        minutes=f"{seconds / 60:.1f}",
        steps=record.steps,
        all_steps=optimisation["steps"],
        samples=optimisation["samples"],
        device=html.escape(device.type),
        undertrained=f"<p>{badge('undertrained', 'warning')} {html.escape(undertrained)}</p>" if undertrained else "",
        in_short=_in_short(scores, model, record, sway),
        verdicts=_verdicts(checked),
        how_it_sits=how_it_sits,
        pictures=pictures,
        counts="{bodies} held-out bodies, {poses} poses each".format(**scores["counts"]),
        figures=_figures(scores),
        curve=record.loss_curve(),
    )
    write_page(output.with_suffix(".html"), model.name, body)
    return scores


def _pictures(
    output: Path,
    model: GarmentModel,
    checked: CheckedGarment,
    template: Avatar,
    worn: Draper | None,
    device: torch.device,
    budget: TimeBudget,
) -> list[str]:
    late = f"there was no time for {{}}: physkin contact-sheet {output.name} draws drapes"
    if budget.left < PICTURE_SECONDS:
        return [_note(late.format("them"))]
    try:
        rest, taken = budget.timed(lambda: at_rest(checked, template))  # three renderings, larger than a pose's three
        poses = int(min(SHEET_POSES, budget.left / 2 / taken))
        parts = ["<p>As it was trained, on the template's body:</p>", _image(rest), "<h2>Drapes</h2>"]
        if worn is not None and budget.left > 3 * taken:
            parts += ["<p>On your avatar, in the poses of the first rows:</p>", _image(worn_in_two_poses(worn))]
        if poses < 1:
            return [*parts, _note(late.format("a sheet"))]
        sheet = draw_sheet(model, device, poses=poses)
    except PictureError as error:
        return [_note(str(error))]
    save_png(output.with_suffix(".png"), sheet)
    said = "Bodies that training has not seen; poses uniform in the joint limits and frames of motion. Percent: mean "
    return [*parts, f'<p class="note">{said}edge strain.</p>', _image(sheet)]


def _note(text: str) -> str:
    return f'<p class="note">No pictures: {html.escape(text)}</p>'


def _in_short(scores: dict, model: GarmentModel, record: TrainingRecord, sway: str) -> str:
    """How good the model is, what it began with, what it learnt and whether longer would help: a list."""
    drape, plain = scores["model"], scores["skinning"]
    good = (
        f"In any pose that the joints allow, edges of the cloth are {drape['edge_strain_percent']:.1f} % longer or "
        f"shorter than at rest on average ({plain['edge_strain_percent']:.1f} % where cloth only follows the bones), "
        f"and {drape['inside_percent']:.1f} % of its vertices are inside the body. In everyday poses it is less."
    )
    begun = taken_over(model.training, sways=model.sway is not None, own_sway=sway)
    said = (good, begun, learnt(model.training, record.rows), record.longer_or_not())
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


def _figures(scores: dict) -> str:
    """The table of `physkin evaluate`, without columns that are empty, and what is said below it, HTML."""
    header, *rows = zip(
        *(column for column in zip(*table_cells(scores)) if any(cell is not None for cell in column[1:]))
    )
    said = "".join(f"<p>{html.escape(line)}</p>" for line in remarks(scores))
    return tabulate(rows, header, tablefmt="html", floatfmt=".3f") + said


def _image(picture: np.ndarray) -> str:
    buffer = io.BytesIO()
    save_png(buffer, picture)
    return image(buffer.getvalue())
