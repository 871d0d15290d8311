"""`physkin train-catalogue`: train every garment of a folder on a Ray cluster, and write a page of them all."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

from physkin_core.cluster.cluster import Cluster, Outcome, add_address, joined
from physkin_core.progress import progress_line
from physkin_training.catalogue.garment_run import train_garment
from physkin_training.catalogue.page import write_page
from physkin_training.catalogue.plan import (
    CatalogueError,
    Job,
    Status,
    find_jobs,
    read_status,
    stage,
    steps_taken,
    write_status,
)
from physkin_training.fit_garment.settings import FitSettings, add_fit_options

__all__ = ["command_parser", "main", "train_catalogue"]

PAGE = "catalogue.html"
PAGE_EVERY = 15
"""Seconds from one page to the next while nothing ends."""
LOOK_EVERY = 2.0


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; 1 when a garment failed. Raises ValueError or OSError for bad input, KeyboardInterrupt
    for Ctrl-C."""
    options = command_parser().parse_args(argv)
    if options.cpus < 1:
        raise CatalogueError(f"--cpus {options.cpus} must be at least 1")
    if options.output.exists() and not options.output.is_dir():
        raise CatalogueError(f"--output {options.output} is a file; a folder is needed")
    jobs = find_jobs(options.folder, options.output, FitSettings.of(options))
    return 1 if train_catalogue(jobs, options.output, options.address, options.cpus, options.device) else 0


def train_catalogue(
    jobs: Sequence[Job], output: Path, address: str | None = None, cpus: int = 1, device: str | None = None
) -> int:
    """Train what is not finished of the jobs, and write the page of all into the folder.

    address, cpus, device: see `joined`. Returns how many garments failed. Raises what `joined` does, and
    KeyboardInterrupt for Ctrl-C, after all checkpoints; the same jobs then go on.
    """
    output.mkdir(parents=True, exist_ok=True)
    stages = {job: stage(job) for job in jobs}
    to_do = [job for job in jobs if stages[job] != "finished"]
    to_do.sort(key=lambda job: stages[job] == "new")  # what was begun is finished first
    counts = Counter(finished=0, resumes=0, new=0) + Counter(stages.values())
    print(f"{counts['finished']} garments are finished, {counts['resumes']} are gone on with, {counts['new']} are new")
    for job in to_do:
        status = read_status(job)
        if status and status.state == "training":  # by a run that is no more
            write_status(job, replace(status, state="stopped"))
    page = output / PAGE
    write_page(page, jobs)
    if not to_do:
        return 0
    try:
        with joined(address, cpus=cpus, device=device) as cluster:
            failed = _train(cluster, jobs, to_do, page)
    except KeyboardInterrupt:
        print("stopped; the same command goes on")
        raise
    finally:
        write_page(page, jobs)
        print(f"wrote {page}")
    return failed


def _train(cluster: Cluster, jobs: Sequence[Job], to_do: Sequence[Job], page: Path) -> int:
    """Returns how many garments failed."""
    failed = ended = 0
    where = "a GPU each" if cluster.gpus else f"{cluster.cpus} processor cores each"
    print(f"training {len(to_do)} garments, {cluster.at_once} at once, {where}")
    watch, written = progress_line(f"training {len(to_do)} garments"), 0.0
    already = {job: _share(job) for job in to_do}
    train = partial(train_garment, device=cluster.device)
    with closing(cluster.run(train, [[job] for job in to_do], look_every=LOOK_EVERY, alone=True)) as outcomes:
        for outcome in outcomes:
            if outcome:
                job, status = outcome.row, outcome.result or _lost(outcome)
                already.pop(job)
                ended += 1
                failed += status.state == "failed"
                said = status.check["verdict"] if status.check else status.reason
                begun = f", begun {status.starts} times" if status.starts > 1 else ""
                print(f"{ended} of {len(to_do)}: {job.name} {status.state}{begun}: {said}")
            if outcome or time.monotonic() > written + PAGE_EVERY:
                write_page(page, jobs, refresh=PAGE_EVERY)
                written = time.monotonic()
            watch((ended + sum(max(0.0, _share(job) - before) for job, before in already.items())) / len(to_do))
    return failed


def _lost(outcome: Outcome) -> Status:
    """Note that the job's worker was lost."""
    job, noted = outcome.row, read_status(outcome.row)
    status = Status(job.fingerprint, "failed", outcome.reason, noted.starts if noted else 0)
    write_status(job, status)
    return status


def _share(job: Job) -> float:
    """How much of a garment's training is done."""
    status, taken = read_status(job), steps_taken(job)
    return taken[0] / taken[1] if status and taken else 0.0


def command_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="physkin train-catalogue", description=__doc__.split("`: ", 1)[1])
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="garment meshes and patterns; NAME.toml beside one is its recipe"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODELS", help="folder to write")
    add_fit_options(parser)
    add_address(parser, "the one on this machine, which is started if need be")
    parser.add_argument("--cpus", type=int, default=1, help="processor cores for each garment (default 1)")
    parser.add_argument(
        "--device", choices=("cpu", "cuda"), help="where to train (default: one GPU for each garment, if there are any)"
    )
    return parser
