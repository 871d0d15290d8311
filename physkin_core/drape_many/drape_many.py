"""`physkin drape-many`: drape many motions on many avatars, on a Ray cluster, and write a file for each."""

from __future__ import annotations

import argparse
import csv
import html
import io
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path

from physkin_core.cluster.cluster import Outcome, add_address
from physkin_core.cluster.rows import FolderRow, Notes, do_rows
from physkin_core.drape_many.jobs import WORN, JobsError, crossed, read_table, rows_of
from physkin_core.export.export import WRITERS, dressed_for
from physkin_core.html_page import write_page
from physkin_core.mesh.look import Look
from physkin_core.outfit.outfit import Outfit
from physkin_core.outfit.outfit_options import add_options, add_outfit_options, as_asked, read_motion

__all__ = ["command_parser", "main"]

PAGE, TABLE = "drape-many.html", "rows.csv"
MOST_SHOWN = 1000
"""Rows that failed on the page; the table has all."""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin drape-many`."""
    parser = argparse.ArgumentParser(prog="physkin drape-many", description=__doc__.split("`: ")[1])
    said = "table of rows, .csv or .jsonl, with the columns avatar, motion, name and options of this command"
    parser.add_argument("jobs", nargs="?", type=Path, metavar="JOBS", help=said)
    parser.add_argument("--motions", type=Path, metavar="FOLDER", help="instead: all motions of a folder, in order")
    parser.add_argument("--avatars", type=Path, metavar="FOLDER", help="each of them on all avatars of a folder")
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
    output = options.output
    if (options.jobs is None) == (options.motions is None) or (options.avatars and options.jobs):
        raise JobsError("give either a table JOBS or --motions FOLDER; --avatars FOLDER goes with --motions")
    if output.exists() and not output.is_dir():
        raise JobsError(f"--output {output} is a file; a folder is needed")
    if options.jobs:
        given, base = read_table(options.jobs), options.jobs.parent
    else:
        given, base = crossed(options.avatars, options.motions), Path()
    rows = rows_of(given, options, base, f".{options.format}")
    work, show = partial(_drape, f".{options.format}"), partial(_show, output, rows)
    failed = do_rows(rows, work, output, show, address=options.address)
    print(f"wrote {output / PAGE} and {output / TABLE}")
    return 1 if failed else 0


def _drape(kind: str, row: FolderRow, folder: Path) -> Notes:
    """Drape a row into a folder. Raises ValueError, OSError or ModuleNotFoundError, saying which row it is."""
    options = row.order
    try:
        motion = read_motion(options)
        outfit, looks = _dressed(kind, row.shares)
        outfit.sway, outfit.wind = options.sway, options.wind
        outfit.reset()
        motion = as_asked(motion, options, outfit)
        lacking = WRITERS[kind](folder / f"{Path(row.name).name}{kind}", outfit, motion, looks=looks)
    except (ValueError, OSError) as error:
        raise type(error)(f"{options.place}: {error}") from error
    warnings = [*outfit.warnings, *lacking]
    return {"frames": motion.frame_count, "rate_hz": motion.rate_hz, "warnings": warnings}


@lru_cache(maxsize=1)
def _dressed(kind: str, worn: str) -> tuple[Outfit, list[Look | None]]:
    """The outfit that rows share. worn: values of `WORN`, JSON."""
    options = argparse.Namespace(**dict(zip(WORN, json.loads(worn))), materials=[])
    options.avatar = Path(options.avatar)
    return dressed_for(kind, options)


def _show(output: Path, rows: Sequence[FolderRow], outcomes: Mapping[str, Outcome], refresh: int) -> None:
    """Write the page; the table, when no more is to come."""
    failed = [outcome for outcome in outcomes.values() if outcome.reason]
    frames = sum(outcome.result["frames"] for outcome in outcomes.values() if outcome.result)
    said = f"{len(outcomes) - len(failed)} finished, {len(failed)} failed, {len(rows) - len(outcomes)} waiting"
    lines = [f"<p>{said}; {frames:,} frames.</p>"]
    lines += [f'<p class="worse">{html.escape(each.row.name)}: {html.escape(each.reason)}</p>' for each in failed]
    write_page(output / PAGE, f"{len(rows)} rows", "\n".join(lines[: MOST_SHOWN + 1]), refresh=refresh)
    if refresh:
        return
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["name", "avatar", "motion", "state", "frames", "rate_hz", "reason", "warnings"])
    for row in rows:
        outcome, order = outcomes.get(row.name), row.order
        notes = (outcome.result if outcome else None) or {}
        state = "waiting" if outcome is None else "failed" if outcome.reason else "finished"
        reason, warnings = outcome.reason if outcome else "", "; ".join(notes.get("warnings", ()))
        table.writerow(
            [row.name, order.avatar, order.motion, state, notes.get("frames"), notes.get("rate_hz"), reason, warnings]
        )
    (output / TABLE).write_text(text.getvalue(), encoding="utf-8")
