"""Rows of work whose results are folders: each is written under another name, then renamed, and never written again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Hashable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any
from uuid import uuid4

from physkin_core.cluster.cluster import Outcome, joined, tried
from physkin_core.progress import progress_line

__all__ = ["NOTES", "FolderRow", "Work", "do_rows"]

NOTES = "row.json"
"""In the folder of every row that is finished."""
UNFINISHED = ".unfinished"
"""In the output folder: folders of rows that are being done."""
LONGEST_BATCH = 64
"""Rows that share a binding: a second of it is little beside them."""
PAGE_EVERY, LOOK_EVERY = 15, 2.0  # [s]

Work = Callable[["FolderRow", Path], dict[str, Any]]
"""Does a row in a folder. Returns what is to be noted of it, in JSON's types, the same whenever it is done."""


@dataclass(frozen=True)
class FolderRow:
    """name: of its folder. order: what the work takes. settings: all that the result depends on, in JSON's types; a row
    with other ones is done anew. shares: rows with the same value are done one after the other by one worker."""

    name: str
    order: Any
    settings: dict[str, Any]
    shares: Hashable = None


def do_rows(
    rows: Sequence[FolderRow],
    work: Work,
    output: Path,
    show: Callable[[dict[str, Outcome], int], None],
    *,
    called: str = "rows",
    address: str | None = None,
    here: bool = False,
) -> int:
    """Do all rows that are not finished, on the Ray cluster that `joined` finds. Returns how many failed.

    show: is called with all outcomes so far, by name, and seconds to the next call, 0 for never. called: what rows
    are. here: one row after the other in this process, without Ray. Raises as `joined`, and KeyboardInterrupt for
    Ctrl-C: the same rows then go on.
    """
    output.mkdir(parents=True, exist_ok=True)
    outcomes = {row.name: Outcome(row, notes) for row in rows if (notes := _notes(row, output)) is not None}
    to_do, ended, shown = [row for row in rows if row.name not in outcomes], 0, 0.0
    print(f"{len(rows)} {called}, {len(outcomes)} of them finished")
    watch, do = progress_line(f"{len(to_do)} {called}"), partial(_do_row, work, output)
    try:
        shutil.rmtree(output / UNFINISHED, ignore_errors=True)
        with ExitStack() as stack:
            done = (outcome for row in to_do for outcome in tried(do, [row]))
            if to_do and not here:
                cluster = stack.enter_context(joined(address))
                batches = _batches(to_do, cluster.at_once)
                done = stack.enter_context(closing(cluster.run(do, batches, look_every=LOOK_EVERY)))
            for outcome in done:
                if outcome:
                    ended += 1
                    outcomes[outcome.row.name] = outcome
                    print(f"{ended} of {len(to_do)}: {outcome.row.name}: {outcome.reason or 'done'}")
                    watch(ended / len(to_do))
                if monotonic() > shown + PAGE_EVERY:
                    show(outcomes, PAGE_EVERY)
                    shown = monotonic()
    finally:
        shutil.rmtree(output / UNFINISHED, ignore_errors=True)
        show(outcomes, 0)
    return sum(bool(outcome.reason) for outcome in outcomes.values())


def _batches(rows: Sequence[FolderRow], at_once: int) -> list[list[FolderRow]]:
    """Of rows that share, short enough that all workers have one."""
    most = min(LONGEST_BATCH, -(-len(rows) // at_once))
    groups: dict[Hashable, list[FolderRow]] = {}
    for row in rows:
        groups.setdefault(row.shares, []).append(row)
    return [group[k : k + most] for group in groups.values() for k in range(0, len(group), most)]


def _notes(row: FolderRow, output: Path) -> dict[str, Any] | None:
    """What was noted of a finished row; None if it is not finished, or was with other settings."""
    try:
        found = json.loads((output / row.name / NOTES).read_text(encoding="utf-8"))
        return found["notes"] if found["settings"] == row.settings else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _do_row(work: Work, output: Path, row: FolderRow) -> dict[str, Any]:
    """Do a row in a folder of its own, and rename that when all is in it."""
    if (notes := _notes(row, output)) is not None:  # by a worker that was lost later
        return notes
    unfinished = output / UNFINISHED / uuid4().hex
    unfinished.mkdir(parents=True)
    try:
        notes = work(row, unfinished)
        text = json.dumps({"settings": row.settings, "notes": notes}, indent=1)
        (unfinished / NOTES).write_text(text, encoding="utf-8")
        shutil.rmtree(output / row.name, ignore_errors=True)
        return unfinished.rename(output / row.name) and notes
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
