"""Rows of work, here or on a cluster: which of them are done is known before, each ends with a result or a reason.

Results of a `FolderRow` are a folder, written under another name and then renamed, and never written again.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any

from physkin_core.cluster.cluster import Outcome, done_on_cluster, tried
from physkin_core.progress import progress_line

__all__ = ["FolderRow", "Show", "Work", "do_folder_rows", "do_rows"]

NOTES = "row.json"
"""In the folder of every row that is finished."""
UNFINISHED = ".unfinished"
"""In the output folder: folders of rows that are being done."""
PAGE_EVERY = 15
"""[s]"""

Show = Callable[[Mapping[str, Outcome], int], None]
"""Shows all outcomes so far, by name, and is called again after some seconds, 0 for never."""
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
    rows: Sequence[Any],
    work: Callable[[Any], Any],
    known: Callable[[Any], Any],
    show: Show,
    *,
    called: str = "rows",
    say: Callable[[Any], str] = lambda _: "done",
    share: Callable[[Any], float] = lambda _: 0.0,
    here: bool = False,
    **where: Any,
) -> int:
    """Do all rows that are not finished, and say how it goes. Returns how many failed.

    rows: have `name` and `shares`. known: what work returned of a finished row, None of others. called: what rows are.
    say: what is said of a result. share: how much of a row that runs is done. here: one row after the other in this
    process, without Ray; else where is as of `done_on_cluster`. Raises as that, and KeyboardInterrupt for Ctrl-C: the
    same rows then go on.
    """
    outcomes = {row.name: Outcome(row, result) for row in rows if (result := known(row)) is not None}
    to_do = {row.name: row for row in rows if row.name not in outcomes}
    print(f"{len(rows)} {called}, {len(outcomes)} of them finished")
    watch, shown, count = progress_line(f"{len(to_do)} {called}"), 0.0, len(to_do)
    left = {name: share(row) for name, row in to_do.items()}
    if here:
        done = (outcome for row in to_do.values() for outcome in tried(work, [row]))
    else:
        done = done_on_cluster(work, list(to_do.values()), **where)
    try:
        with closing(done):
            for outcome in done if to_do else ():
                if outcome:
                    name = outcome.row.name
                    outcomes[name] = outcome
                    del left[name]
                    print(f"{count - len(left)} of {count}: {name}: {outcome.reason or say(outcome.result)}")
                watch((count - len(left) + sum(share(to_do[name]) - begun for name, begun in left.items())) / count)
                if monotonic() > shown + PAGE_EVERY:
                    show(outcomes, PAGE_EVERY)
                    shown = monotonic()
    except KeyboardInterrupt:
        print("stopped; the same command goes on")
        raise
    finally:
        show(outcomes, 0)
    return sum(bool(outcome.reason) for outcome in outcomes.values())


def do_folder_rows(rows: Sequence[FolderRow], work: Work, output: Path, show: Show, **how: Any) -> int:
    """`do_rows` into folders of their names. how: its other arguments."""
    (output / UNFINISHED).mkdir(parents=True, exist_ok=True)
    try:
        return do_rows(rows, partial(_do_row, work, output), partial(_notes, output), show, **how)
    finally:
        shutil.rmtree(output / UNFINISHED, ignore_errors=True)


def _notes(output: Path, row: FolderRow) -> dict[str, Any] | None:
    """What was noted of a finished row; None if it is not finished, or was with other settings."""
    try:
        found = json.loads((output / row.name / NOTES).read_text(encoding="utf-8"))
        return found["notes"] if found["settings"] == row.settings else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _do_row(work: Work, output: Path, row: FolderRow) -> dict[str, Any]:
    """Do a row in a folder of its own, and rename that when all is in it."""
    if (notes := _notes(output, row)) is not None:  # by a worker that was lost later
        return notes
    with TemporaryDirectory(dir=output / UNFINISHED) as made:
        folder = Path(made) / row.name
        folder.mkdir()
        notes = work(row, folder)
        text = json.dumps({"settings": row.settings, "notes": notes}, indent=1)
        (folder / NOTES).write_text(text, encoding="utf-8")
        shutil.rmtree(output / row.name, ignore_errors=True)
        folder.rename(output / row.name)
    return notes
