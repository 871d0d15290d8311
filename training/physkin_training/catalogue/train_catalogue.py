"""`physkin train-catalogue`: train every garment of a folder on a Ray cluster, and write a page of them all."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from physkin_core.cluster.cluster import Outcome, add_address
from physkin_core.cluster.rows import do_rows
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

    address, cpus, device: see `done_on_cluster`. Returns how many garments failed. Raises what that does, and
    KeyboardInterrupt for Ctrl-C, after all checkpoints; the same jobs then go on.
    """
    output.mkdir(parents=True, exist_ok=True)
    show = partial(_show, output / PAGE, jobs)
    show({}, 0)  # what was begun by a run that is no more was stopped
    in_order = sorted(jobs, key=lambda job: stage(job) == "new")  # what was begun is finished first
    where = {"address": address, "cpus": cpus, "device": device, "alone": True}
    failed = do_rows(in_order, train_garment, _finished, show, called="garments", say=_said, share=_share, **where)
    print(f"wrote {output / PAGE}")
    return failed


def _finished(job: Job) -> Status | None:
    return read_status(job) if stage(job) == "finished" else None


def _show(page: Path, jobs: Sequence[Job], outcomes: Mapping[str, Outcome], refresh: int) -> None:
    """Write the page; how a training ended that could not note it itself is noted."""
    for job in jobs:
        reason, status = outcomes.get(job.name, Outcome(job)).reason, read_status(job)
        if reason:
            write_status(
                job, replace(status or Status(job.fingerprint, "failed", starts=0), state="failed", reason=reason)
            )
        elif not refresh and status and status.state == "training":
            write_status(job, replace(status, state="stopped"))
    write_page(page, jobs, refresh=refresh)


def _said(status: Status) -> str:
    return f"{status.check['verdict']}, begun {status.starts} times" if status.starts > 1 else status.check["verdict"]


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
