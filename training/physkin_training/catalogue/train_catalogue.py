"""`physkin train-catalogue`: train every garment of a folder on a Ray cluster, and write a page of them all."""

from __future__ import annotations

import argparse
import math
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from physkin_core.outfit.outfit_options import add_avatar_options
from physkin_core.progress import progress_line
from physkin_training.catalogue.cluster import joined
from physkin_training.catalogue.page import write_page
from physkin_training.catalogue.plan import (
    CatalogueError,
    Job,
    find_jobs,
    read_status,
    stage,
    steps_taken,
    write_status,
)
from physkin_training.fit_garment.options import add_training_options

__all__ = ["command_parser", "main"]

PAGE = "catalogue.html"
PAGE_EVERY = 15
"""Seconds from one page to the next while nothing ends."""
LOOK_EVERY = 2.0
INTERRUPTED = 130


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; 1 when a garment failed; 130 for Ctrl-C. Raises ValueError or OSError for bad input."""
    options = command_parser().parse_args(argv)
    _check(options)
    chosen = {"recipe": options.recipe, "avatar": options.avatar, "rig": options.rig}
    jobs = find_jobs(
        options.folder,
        options.output,
        length=_given(options, "minutes", "steps", "from"),
        arguments=_arguments(options),
        **chosen,
    )
    options.output.mkdir(parents=True, exist_ok=True)
    stages = {job: stage(job) for job in jobs}
    to_do = [job for job in jobs if stages[job] != "finished"]
    to_do.sort(key=lambda job: stages[job] == "new")  # what was begun is finished first
    counts = {name: list(stages.values()).count(name) for name in ("finished", "resumes", "new")}
    print("{finished} garments are finished, {resumes} are gone on with, {new} are new".format(**counts))
    for job in to_do:
        status = read_status(job)
        if status and status.state == "training":  # by a run that is no more
            write_status(job, replace(status, state="stopped"))
    page = options.output / PAGE
    write_page(page, jobs)
    if not to_do:
        return 0
    try:
        status = 1 if _train(options, jobs, to_do, page) else 0
    except KeyboardInterrupt:
        print("stopped; the same command goes on")
        status = INTERRUPTED
    finally:
        write_page(page, jobs)
    print(f"wrote {page}")
    return status


def _train(options: argparse.Namespace, jobs: list[Job], to_do: list[Job], page: Path) -> int:
    """Returns how many garments failed."""
    failed = ended = 0
    limits = {"cpus": options.cpus, "retries": options.retries, "at_once": options.workers, "device": options.device}
    with joined(options.address, **limits) as cluster:
        where = "a GPU each" if cluster.gpus else f"{cluster.cpus} processor cores each"
        print(f"training {len(to_do)} garments, {cluster.at_once} at once, {where}")
        watch, written = progress_line(f"training {len(to_do)} garments"), 0.0
        already = {job: _share(job) for job in to_do}
        with closing(cluster.run(to_do, look_every=LOOK_EVERY)) as outcomes:
            for outcome in outcomes:
                if outcome:
                    job, status = outcome
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


def _share(job: Job) -> float:
    """How much of a garment's training is done."""
    status, taken = read_status(job), steps_taken(job)
    return taken[0] / taken[1] if status and taken else 0.0


def _check(options: argparse.Namespace) -> None:
    for name in ("minutes", "checkpoint_every"):
        value = getattr(options, name)
        if value is not None and not 0 < value < math.inf:
            raise CatalogueError(f"--{name.replace('_', '-')} {value:g} must be above 0 and finite")
    for name, least in (("steps", 1), ("workers", 1), ("cpus", 1), ("retries", 0), ("bodies", 1), ("poses", 1)):
        value = getattr(options, name)
        if value is not None and value < least:
            raise CatalogueError(f"--{name} {value} must be at least {least}")
    for name in ("avatar", "rig", "recipe"):
        value = getattr(options, name)
        if value is not None and not Path(value).is_file():
            raise CatalogueError(f"--{name} {value}: no such file")
    if options.output.exists() and not options.output.is_dir():
        raise CatalogueError(f"--output {options.output} is a file; a folder is needed")


def _given(options: argparse.Namespace, *names: str) -> list[str]:
    """Options that have a value, for `physkin fit-garment`."""
    values = {name: getattr(options, name) for name in names}
    return [f"--{name.replace('_', '-')}={value}" for name, value in values.items() if value is not None]


def _arguments(options: argparse.Namespace) -> list[str]:
    """What the model does not depend on."""
    accepted = ["--accept-placement"] if options.accept_placement else []
    return _given(options, "checkpoint_every", "bodies", "poses") + accepted


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin train-catalogue`."""
    parser = argparse.ArgumentParser(prog="physkin train-catalogue", description=__doc__.split("`: ", 1)[1])
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="garment meshes and patterns; NAME.toml beside one is its recipe"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODELS", help="folder to write")
    add_avatar_options(parser, made_on=True)
    add_training_options(parser)
    parser.add_argument(
        "--address", help="address of a Ray cluster (default: the one on this machine, which is started if need be)"
    )
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="garments that train at the same time, at most (default: as many as fit)",
    )
    parser.add_argument("--cpus", type=int, default=1, help="processor cores for each garment (default 1)")
    parser.add_argument(
        "--device", choices=("cpu", "cuda"), help="where to train (default: one GPU for each garment, if there are any)"
    )
    parser.add_argument(
        "--retries", type=int, default=3, help="new attempts for a garment whose worker was lost (default 3)"
    )
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
