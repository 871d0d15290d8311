"""Rows of work whose results are folders: each is written under another name, then renamed, and never written again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any
from uuid import uuid4

from physkin_core.cluster.cluster import Outcome, joined, tried
from physkin_core.progress import progress_line

__all__ = ["NOTES", "FolderRow", "Notes", "Work", "do_rows", "notes_of"]

NOTES = "row.json"
"""In the folder of every row that is finished."""
UNFINISHED = ".unfinished"
"""In the output folder: folders of rows that are being done."""
MOST_AT_ONCE = 64
"""Rows of a batch: they share a binding, and a second of it is little beside them."""
PAGE_EVERY = 15
LOOK_EVERY = 2.0  # [s]

Notes = dict[str, Any]
Work = Callable[["FolderRow", Path], Notes]
"""Does a row in a folder. Returns what is to be noted of it, in JSON's types, the same whenever it is done."""


@dataclass(frozen=True)
class FolderRow:
    """name: of the folder to write, with "/" for folders in it. order: what the work takes. settings: all that the
    result depends on, in JSON's types; a row with other ones is done anew. shares: rows with the same value come one
    after the other on one worker, so that it can keep what is costly to prepare."""

    name: str
    order: Any
    settings: Notes
    shares: Hashable = None


def notes_of(row: FolderRow, output: Path) -> Notes | None:
    """What was noted of a finished row; None if it is not finished, or was with other settings."""
    try:
        found = json.loads((output / row.name / NOTES).read_text(encoding="utf-8"))
        return found["notes"] if found["settings"] == row.settings else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def do_rows(
    rows: Sequence[FolderRow],
    work: Work,
    output: Path,
    show: Callable[[dict[str, Outcome[FolderRow]], int], None],
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
    found = ((row, notes_of(row, output)) for row in rows)
    outcomes = {row.name: Outcome(row, notes) for row, notes in found if notes is not None}
    to_do = [row for row in rows if row.name not in outcomes]
    print(f"{len(rows)} {called}, {len(outcomes)} of them finished")
    watch, shown, ended = progress_line(f"{len(to_do)} {called}"), 0.0, 0
    try:
        shutil.rmtree(output / UNFINISHED, ignore_errors=True)
        with _started(to_do, partial(_do_row, work, output), address, here) as done:
            for outcome in done:
                if outcome:
                    ended += 1
                    outcomes[outcome.row.name] = outcome
                    print(f"{ended} of {len(to_do)}: {outcome.row.name}: {outcome.reason or 'done'}")
                    watch(ended / len(to_do))
                if monotonic() > shown + PAGE_EVERY:
                    show(outcomes, PAGE_EVERY)
                    shown = monotonic()
    except KeyboardInterrupt:
        print("stopped; the same command goes on")
        raise
    finally:
        shutil.rmtree(output / UNFINISHED, ignore_errors=True)
        show(outcomes, 0)
    return sum(bool(outcome.reason) for outcome in outcomes.values())


@contextmanager
def _started(
    rows: Sequence[FolderRow], work: Callable[[FolderRow], Notes], address: str | None, here: bool
) -> Iterator[Iterator[Outcome[FolderRow] | None]]:
    """Outcomes, as rows end."""
    if here or not rows:
        yield (outcome for row in rows for outcome in tried(work, [row]))
        return
    with joined(address) as cluster:
        batches = _batches(rows, cluster.at_once)
        print(f"{len(batches)} batches, {cluster.at_once} at once")
        with closing(cluster.run(work, batches, look_every=LOOK_EVERY)) as outcomes:
            yield outcomes


def _batches(rows: Sequence[FolderRow], at_once: int) -> list[list[FolderRow]]:
    """Of rows that share, as long as all workers have one."""
    most = min(MOST_AT_ONCE, -(-len(rows) // at_once))
    groups: dict[Hashable, list[FolderRow]] = {}
    for row in rows:
        groups.setdefault(row.shares, []).append(row)
    return [group[k : k + most] for group in groups.values() for k in range(0, len(group), most)]


def _do_row(work: Work, output: Path, row: FolderRow) -> Notes:
    """Do a row in a folder of its own, and rename that when all is in it."""
    if (notes := notes_of(row, output)) is not None:  # by a worker that was lost later
        return notes
    unfinished, folder = output / UNFINISHED / uuid4().hex, output / row.name
    unfinished.mkdir(parents=True)
    try:
        notes = work(row, unfinished)
        text = json.dumps({"settings": row.settings, "notes": notes}, indent=1)
        (unfinished / NOTES).write_text(text, encoding="utf-8")
        folder.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(folder, ignore_errors=True)
        unfinished.rename(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return notes
