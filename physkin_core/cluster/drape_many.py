"""`physkin drape-many`: drape many motions on many avatars, on a Ray cluster, and write a file for each."""

from __future__ import annotations

import argparse
import csv
import html
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from physkin_core.cluster.cluster import Outcome, add_address
from physkin_core.cluster.jobs import JobsError, crossed, read_table, rows_of
from physkin_core.cluster.rows import FolderRow, do_folder_rows
from physkin_core.export.export import WRITERS, dressed_for
from physkin_core.html_page import write_page
from physkin_core.outfit.outfit_options import add_options, add_outfit_options, as_asked, read_motion

__all__ = ["command_parser", "main"]

PAGE, TABLE = "drape-many.html", "rows.csv"
MOST_SHOWN = 1000
"""Rows that failed on the page; the table has all."""
KEPT: dict[Any, Any] = {}
"""In a worker, what the last row wore, by what it shared with others."""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin drape-many`."""
    parser = argparse.ArgumentParser(prog="physkin drape-many", description=__doc__.split("`: ")[1])
    said = "table of rows, .csv or .jsonl, with the columns avatar, motion, name and options of this command"
    given = parser.add_mutually_exclusive_group(required=True)
    given.add_argument("jobs", nargs="?", type=Path, metavar="JOBS", help=said)
    given.add_argument("--motions", type=Path, metavar="FOLDER", help="instead: all motions of a folder")
    parser.add_argument("--avatars", type=Path, metavar="FOLDER", help="with --motions: on all avatars of a folder")
    add_outfit_options(parser)
    add_options(parser, "source-rate", "rate", "separate-limbs", "sway", "wind")
    parser.set_defaults(materials=[])
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="a folder for each row in it"
    )
    kinds = [kind[1:] for kind in WRITERS]
    parser.add_argument("--format", choices=kinds, default="zarr", help="of results (default %(default)s: arrays)")
    add_address(parser, "the one on this machine, which is started if need be")
    return parser


def main(argv: list[str]) -> int:
    """Command line. Returns 0; 1 when a row failed. Raises ValueError or OSError for bad input."""
    options = command_parser().parse_args(argv)
    output, kind = options.output, f".{options.format}"
    if options.jobs and options.avatars:
        raise JobsError(f"--avatars {options.avatars} goes with --motions; the table {options.jobs} names its avatars")
    if output.exists() and not output.is_dir():
        raise JobsError(f"--output {output} is a file; a folder is needed")
    table = read_table(options.jobs) if options.jobs else crossed(options.avatars, options.motions)
    rows = rows_of(table, options, kind)
    failed = do_folder_rows(rows, partial(_drape, kind), output, partial(_show, output, rows), address=options.address)
    print(f"wrote {output / PAGE} and {output / TABLE}")
    return 1 if failed else 0


def _drape(kind: str, row: FolderRow, folder: Path) -> dict[str, Any]:
    """Drape a row into a folder. Raises as what reads and writes does."""
    motion = read_motion(row.order)
    if row.shares not in KEPT:
        KEPT.clear()
        KEPT[row.shares] = dressed_for(kind, row.order)
    outfit, looks = KEPT[row.shares]
    outfit.sway, outfit.wind = row.order.sway, row.order.wind
    outfit.reset()
    motion = as_asked(motion, row.order, outfit)
    lacking = WRITERS[kind](folder / f"{row.name}{kind}", outfit, motion, looks=looks)
    return {"frames": motion.frame_count, "rate_hz": motion.rate_hz, "warnings": [*outfit.warnings, *lacking]}


def _show(output: Path, rows: Sequence[FolderRow], outcomes: Mapping[str, Outcome], refresh: int) -> None:
    """Write the page; the table, too, when no more is to come."""
    cells = []
    for row in rows:
        outcome = outcomes.get(row.name, Outcome(row))
        frames = (outcome.result or {}).get("frames")
        cells.append((row.name, row.order.avatar, row.order.motion, frames, outcome.reason))
    failed = [html.escape(f"{name}: {reason}") for name, *_, reason in cells if reason]
    frames = [count for *_, count, _ in cells if count]
    said = f"{len(frames)} finished, {len(failed)} failed, {len(rows) - len(outcomes)} waiting; {sum(frames):,} frames"
    lines = [f'<p class="worse">{line}</p>' for line in failed[:MOST_SHOWN]]
    write_page(output / PAGE, f"{len(rows)} rows", "\n".join([f"<p>{said}.</p>", *lines]), refresh=refresh)
    if not refresh:
        with open(output / TABLE, "w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([("name", "avatar", "motion", "frames", "reason"), *cells])
