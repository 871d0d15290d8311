"""The page of a catalogue: a picture, figures and a verdict for each garment, in one HTML file."""

from __future__ import annotations

import base64
import html
from collections import Counter
from collections.abc import Sequence

from tabulate import tabulate

from physkin_core.html_page import badge
from physkin_training.catalogue.plan import LOG, PICTURE, Job, Status, read_status, steps_taken
from physkin_training.fit_garment.fit_garment import FIRST, PLACEMENT

__all__ = ["catalogue_table"]

HEAD = (
    "",
    "garment",
    "it sits",
    "on the avatar, everyday poses",
    "held-out bodies, all poses",
    "training",
    "the mesh",
)
COLOURS = {"training": "repaired", "failed": "refused", "good": "ok", "usable": "warning", "bad": "refused"}
"""State or verdict -> outcome of a check that has its colour; others are unsure."""
PICTURES = {PICTURE: "jpeg", FIRST: "png", PLACEMENT: "png"}
"""In a garment's folder, the best first, and its format."""


def catalogue_table(jobs: Sequence[Job]) -> str:
    """HTML, from what lies on disk."""
    statuses = {job: read_status(job) for job in jobs}
    counts = Counter(status.state if status else "waiting" for status in statuses.values())
    said = ", ".join(f"{count} {state}" for state, count in counts.items())
    rows = [_row(job, status) for job, status in statuses.items()]
    return f"<p>{said}.</p>\n{tabulate(rows, HEAD, tablefmt='unsafehtml', disable_numparse=True)}"


def _row(job: Job, status: Status | None) -> list[str]:
    state = status.state if status else "waiting"
    name = html.escape(job.name)
    if state == "finished":
        name = f'<a href="{job.output.with_suffix(".html").name}">{name}</a>'
    verdict = status.check["verdict"] if status and status.check else state
    found = (status.fitted if status else None) or {}
    cells = [
        _picture(job) if status else "",
        name,
        badge(verdict, COLOURS.get(verdict, "unsure")),
        _on_avatar(status.check) if status and status.check else "",
        _held_out(found["figures"]) if found else "",
        _training(job, status, found) if status else "",
        _mesh(found["verdicts"]) if found else "",
    ]
    if state == "failed":
        log = f'<a href="{job.folder.name}/{LOG}">log</a>'
        cells[3] = f"{html.escape(status.reason)} ({log})"
    return cells


def _picture(job: Job) -> str:
    for name, kind in PICTURES.items():
        if (job.folder / name).exists():
            data = base64.b64encode((job.folder / name).read_bytes()).decode()
            style = 'style="width: 300px; max-width: none"'
            return f'<img {style} src="data:image/{kind};base64,{data}" alt="{html.escape(job.name)}">'
    return ""


def _on_avatar(check: dict) -> str:
    inside = "inside {inside_percent:.2f} %, {deepest_mm:.0f} mm deep".format(**check["everyday"])
    edges = "edges {edge_strain_percent:.1f} %".format(**check["everyday"])
    return _lines([edges, inside, "inside at rest {inside_percent:.2f} %".format(**check["rest"])])


def _held_out(figures: dict) -> str:
    """Strains of the model and of plain skinning."""
    words = (("edges", "edge_strain_percent"), ("areas", "area_strain_percent"), ("inside", "inside_percent"))
    model, skinning = figures["model"], figures["skinning"]
    return _lines([f"{word} {model[key]:.1f} %, skinning {skinning[key]:.1f} %" for word, key in words])


def _training(job: Job, status: Status, found: dict) -> str:
    lines = []
    if taken := steps_taken(job):
        lines.append("{:,} of {:,} steps".format(*taken))
    if found:
        lines += [f"{found['seconds'] / 60:.1f} minutes", html.escape(found["advice"])]
    if status.starts > 1:
        lines.append(f"begun {status.starts} times")
    lines += [f"gone on at step {step:,}" for step in status.resumed_at]
    return f'<div style="min-width: 14em">{"<br>".join(lines)}</div>'


def _mesh(checks: Sequence[dict]) -> str:
    """What was not simply right."""
    shown = [check for check in checks if check["outcome"] != "ok"]
    lines = [f"{badge(check['outcome'], check['outcome'])} {html.escape(check['check'])}" for check in shown]
    return _lines(lines or ["all is well"])


def _lines(lines: Sequence[str]) -> str:
    """Short lines below each other, HTML."""
    return "".join(f'<div style="white-space: nowrap">{line}</div>' for line in lines)
