"""Rows of work, here or on a Ray cluster, resumed after a stop. Each ends with a result or a reason.

Results of a `FolderRow` are a folder, written elsewhere and then renamed, and never written again.
"""

from __future__ import annotations

import argparse
import html
import json
import logging
import math
import os
import shutil
import socket
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any

from physkin_core.html_page import write_page
from physkin_core.progress import progress_line

__all__ = ["FolderRow", "Outcome", "add_address", "do_folder_rows", "do_rows", "done_on_cluster"]

LETTING_GO = 60.0
"""Time [s] that work gets to write what it keeps when all is stopped."""
ANSWER, LOOK_EVERY = 5.0, 2.0
"""Times [s] that a cluster gets to answer, and between looks at what has ended."""
RETRIES = 3
"""New attempts for a batch whose worker was lost."""
LONGEST_BATCH = 64
"""Rows that share a binding: a second of it is little beside them."""
NOTES = "row.json"
"""In the folder of every row that is finished."""
UNFINISHED = ".unfinished"
"""In the output folder: folders of rows that are being done."""
PAGE_EVERY = 15  # [s]

Body = Callable[[Mapping[str, "Outcome"], int], str]
"""What a page shows, in HTML, of all outcomes so far, by name. It is asked again after some seconds, 0 for never."""
Work = Callable[["FolderRow", Path], dict[str, Any]]
"""Does a row in a folder. Returns what is to be noted of it, in JSON's types, the same whenever it is done."""


@dataclass(frozen=True)
class Outcome:
    """How a row ended. result: what its work returned, None if it failed. reason: why it failed, else empty."""

    row: Any
    result: Any = None
    reason: str = ""


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
    page: Path,
    body: Body,
    *,
    called: str = "rows",
    say: Callable[[Any], str] = lambda _: "done",
    share: Callable[[Any], float] = lambda _: 0.0,
    here: bool = False,
    **where: Any,
) -> int:
    """Do all rows that are not finished, and say on a page and here how it goes. Returns the exit status: 1 if one
    failed.

    rows: have `name` and `shares`. known: what work returned of a finished row, None of others. called: what rows are.
    say: what is said of a result. share: how much of a row that runs is done. here: one row after the other in this
    process, without Ray; else where is as of `done_on_cluster`. Raises as that, ValueError where the page's folder is a
    file, and KeyboardInterrupt for Ctrl-C: the same rows then go on.
    """
    if page.parent.exists() and not page.parent.is_dir():
        raise ValueError(f"--output {page.parent} is a file; a folder is needed")
    page.parent.mkdir(parents=True, exist_ok=True)
    outcomes = {row.name: Outcome(row, result) for row in rows if (result := known(row)) is not None}
    to_do = {row.name: row for row in rows if row.name not in outcomes}
    print(f"{len(rows)} {called}, {len(outcomes)} of them finished")
    watch, shown, count = progress_line(f"{len(to_do)} {called}"), 0.0, len(to_do)
    left = {name: share(row) for name, row in to_do.items()}
    done: Iterator[Outcome | None] = (outcome for row in to_do.values() for outcome in tried(work, [row]))
    if not here:
        done = done_on_cluster(work, list(to_do.values()), **where)

    def show(refresh: int) -> None:
        failed = [f"{name}: {outcome.reason}" for name, outcome in outcomes.items() if outcome.reason]
        said = f"{len(outcomes) - len(failed)} finished, {len(failed)} failed, {len(rows) - len(outcomes)} to do"
        lines = [f"<p>{said}.</p>", *(f'<p class="worse">{html.escape(line)}</p>' for line in failed)]
        write_page(page, f"{len(rows)} {called}", "\n".join([*lines, body(outcomes, refresh)]), refresh=refresh)

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
                    show(PAGE_EVERY)
                    shown = monotonic()
    except KeyboardInterrupt:
        print("stopped; the same command goes on")
        raise
    finally:
        show(0)
        print(f"wrote {page}")
    return int(any(outcome.reason for outcome in outcomes.values()))


def do_folder_rows(rows: Sequence[FolderRow], work: Work, page: Path, body: Body, **how: Any) -> int:
    """`do_rows` into folders of their names beside the page. how: its other arguments."""
    try:
        return do_rows(rows, partial(_do_row, work, page.parent), partial(_notes, page.parent), page, body, **how)
    finally:
        shutil.rmtree(page.parent / UNFINISHED, ignore_errors=True)


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
    (output / UNFINISHED).mkdir(exist_ok=True)
    with TemporaryDirectory(dir=output / UNFINISHED) as made:
        folder = Path(made) / row.name
        folder.mkdir()
        notes = work(row, folder)
        text = json.dumps({"settings": row.settings, "notes": notes}, indent=1)
        (folder / NOTES).write_text(text, encoding="utf-8")
        shutil.rmtree(output / row.name, ignore_errors=True)
        folder.rename(output / row.name)
    return notes


def done_on_cluster(
    work: Callable[[Any], Any],
    rows: Sequence[Any],
    *,
    address: str | None,
    cpus: int = 1,
    device: str | None = "cpu",
    alone: bool = False,
) -> Iterator[Outcome | None]:
    """Every row with how it ended, as batches end; None every `LOOK_EVERY` seconds in which none has. The cluster is
    that at an address; without one, what `RAY_ADDRESS` names or runs on this machine, else one that is started here and
    ended with the rows.

    work: is called again for rows of a batch whose worker was lost. After `RETRIES` the rows of such a batch are tried
    by themselves, so that a row that ends its process takes no other one with it. rows: those of equal `shares` are
    done one after the other. cpus: cores a batch. device: "cpu" to leave GPUs alone, None for one GPU a batch where
    there are any. alone: each row has a process of its own, so that no other one sees what it leaves behind, in memory
    or of a crash. When the caller stops listening, running work is interrupted (KeyboardInterrupt), and no more begins.
    Raises ModuleNotFoundError without Ray, ConnectionError where no cluster answers, ValueError where no machine has so
    many cores or a GPU.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is reported to anybody
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")  # Ray tells of a lost worker in forty lines
    import ray

    _check_address(address)
    ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    running: dict[Any, Sequence[Any]] = {}
    try:
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        with_gpu = [machine for machine in machines if machine.get("GPU", 0) >= 1]
        if device == "cuda" and not with_gpu:
            raise ValueError("--device cuda: no machine of the cluster has a GPU; allowed: cpu")
        gpus = int(device != "cpu" and bool(with_gpu))
        machines = with_gpu if gpus else machines
        most = max(int(machine.get("CPU", 0)) for machine in machines)
        if cpus > most:
            raise ValueError(f"--cpus {cpus}: no machine of the cluster has more than {most} for each row")
        room = ((machine.get("CPU", 0) // cpus, machine["GPU"] if gpus else math.inf) for machine in machines)
        at_once = sum(int(min(each)) for each in room)
        most, groups = min(LONGEST_BATCH, -(-len(rows) // at_once)), {}
        for row in rows:
            groups.setdefault(row.name if alone else row.shares, []).append(row)
        waiting = [group[k : k + most] for group in groups.values() for k in range(0, len(group), most)][::-1]
        options = {"num_cpus": cpus, "num_gpus": gpus, "max_retries": RETRIES, "max_calls": int(alone)}
        remote = ray.remote(**options)(tried)
        while waiting or running:
            while waiting and len(running) < at_once:
                batch = waiting.pop()
                running[remote.remote(work, batch, os.getcwd())] = batch  # paths mean the same to workers
            done, _ = ray.wait(list(running), timeout=LOOK_EVERY)
            if not done:
                yield None
            for task in done:
                batch = running.pop(task)
                try:
                    yield from ray.get(task)
                except ray.exceptions.RayError as error:
                    if len(batch) > 1:
                        waiting += [[row] for row in batch]
                        continue
                    lost = isinstance(error, ray.exceptions.WorkerCrashedError | ray.exceptions.NodeDiedError)
                    reason = f"its worker was lost {RETRIES + 1} times" if lost else " ".join(str(error).split())
                    yield Outcome(batch[0], reason=reason)
    finally:
        for task in running:
            ray.cancel(task)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=LETTING_GO)
        ray.shutdown()


def tried(work: Callable[[Any], Any], rows: Sequence[Any], folder: str = ".") -> list[Outcome]:
    """Do rows one after the other, paths being from a folder on. One that raises an exception has its reason, and the
    others go on."""
    os.chdir(folder)
    outcomes = []
    for row in rows:
        try:
            outcomes.append(Outcome(row, work(row)))
        except Exception as error:
            said, kind = " ".join(str(error).split()), type(error)
            known = said and (issubclass(kind, ValueError | OSError | ImportError) or kind.__module__[:7] == "physkin")
            outcomes.append(Outcome(row, reason=said if known else f"{kind.__name__}: {said}"))
    return outcomes


def add_address(parser: argparse.ArgumentParser, default: str) -> None:
    """Add `--address`. default: what is used without it."""
    parser.add_argument("--address", metavar="HOST:PORT", help=f"address of a Ray cluster (default: {default})")


def _check_address(address: str | None) -> None:
    """Raises ConnectionError where nothing answers; Ray would try for minutes. Names ("auto") are left to it."""
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if not host:
        return
    try:
        socket.create_connection((host, int(port)), timeout=ANSWER).close()
    except (OSError, ValueError, OverflowError) as error:
        said = f"--address {address}: no Ray cluster answers there ({error}); allowed: HOST:PORT"
        raise ConnectionError(said) from error
