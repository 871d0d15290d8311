"""`physkin train-catalogue`: train every garment of a folder on a Ray cluster, and write a page of them all."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from PIL import Image

from physkin_core import BUNDLED_AVATAR, Draper, GarmentModel, load_avatar
from physkin_core.check.garment_check import check_garment
from physkin_core.cluster.cluster import Outcome, add_address, do_rows
from physkin_core.pictures.picture import PictureError
from physkin_training.catalogue.page import catalogue_table
from physkin_training.catalogue.plan import (
    LOG,
    PICTURE,
    CatalogueError,
    Job,
    Status,
    find_jobs,
    read_status,
    stage,
    steps_taken,
    write_status,
)
from physkin_training.fit_garment.fit_garment import FIRST, PLACEMENT, fit_garment, log_progress
from physkin_training.fit_garment.pictures import in_motion
from physkin_training.fit_garment.settings import FitSettings, add_fit_options
from physkin_training.train.checkpoint import checkpoint_step
from physkin_training.train.run import CHECKPOINT

__all__ = ["command_parser", "main", "train_catalogue"]

PAGE = "catalogue.html"


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; 1 when a garment failed. Raises ValueError or OSError for bad input, KeyboardInterrupt
    for Ctrl-C."""
    options = command_parser().parse_args(argv)
    if options.cpus < 1:
        raise CatalogueError(f"--cpus {options.cpus} must be at least 1")
    jobs = find_jobs(options.folder, options.output, FitSettings.of(options))
    return train_catalogue(jobs, options.output, options.address, options.cpus, options.device)


def train_catalogue(
    jobs: Sequence[Job], output: Path, address: str | None = None, cpus: int = 1, device: str | None = None
) -> int:
    """Train what is not finished of the jobs, and write the page of all into the folder.

    address, cpus, device: see `done_on_cluster`. Returns and raises as `do_rows`; KeyboardInterrupt for Ctrl-C comes
    after all checkpoints.
    """
    _body(jobs, {}, 0)  # what was begun by a run that is no more was stopped
    where = {"address": address, "cpus": cpus, "device": device, "alone": True}
    return do_rows(
        sorted(jobs, key=lambda job: stage(job) == "new"),  # what was begun is finished first
        train_garment,
        lambda job: read_status(job) if stage(job) == "finished" else None,
        output / PAGE,
        partial(_body, jobs),
        called="garments",
        say=lambda status: f"{status.check['verdict']}, begun {status.starts} times".removesuffix(", begun 1 times"),
        share=lambda job: taken[0] / taken[1] if read_status(job) and (taken := steps_taken(job)) else 0.0,
        **where,
    )


def _body(jobs: Sequence[Job], outcomes: Mapping[str, Outcome], refresh: int) -> str:
    """Of the page; how a training ended that could not note it itself is noted."""
    for job in jobs:
        status = read_status(job) or Status(job.fingerprint, "failed", starts=0)
        if reason := outcomes.get(job.name, Outcome(job)).reason:
            write_status(job, replace(status, state="failed", reason=reason))
        elif not refresh and status.state == "training":
            write_status(job, replace(status, state="stopped"))
    return catalogue_table(jobs)


def train_garment(job: Job) -> Status:
    """Check, train and report on the job's garment as `physkin fit-garment` does; go on where it was stopped. On a GPU
    if Ray has given this process one.

    All that this process prints from here on goes into the log in the garment's folder. Raises as `fit_garment` does
    for a mesh that is refused, and whatever training ends with.
    """
    import ray

    device = "cuda" if ray.get_gpu_ids() else "cpu"
    resumes = stage(job) == "resumes"
    status = read_status(job) or Status(job.fingerprint, "training", starts=0)
    resumed_at = [*status.resumed_at, checkpoint_step(job.folder / CHECKPOINT)] if resumes else []
    status = replace(status, state="training", reason="", starts=status.starts + 1, resumed_at=resumed_at)
    if not resumes:  # of another mesh or other settings, perhaps
        for name in (CHECKPOINT, PICTURE, FIRST, PLACEMENT, "losses.jsonl"):
            (job.folder / name).unlink(missing_ok=True)
    write_status(job, status)
    _print_into(job.folder / LOG)
    log_progress()
    try:
        fitted = fit_garment(job.mesh, job.output, replace(job.settings, device=device))
        check = _looked_at(job, fitted.model)
    except Exception as error:
        print(f"error: {error}", file=sys.stderr)
        raise
    status = replace(status, state="finished", check=check, fitted=asdict(replace(fitted, model=None)))
    write_status(job, status)
    return status


def _looked_at(job: Job, model: GarmentModel) -> dict:
    """Figures of the trained garment on the avatar; its picture in a frame of motion is written."""
    worn = job.settings
    avatar = load_avatar(worn.avatar or BUNDLED_AVATAR, model.rig, rig_file=worn.rig, bones=worn.bones)
    draper = Draper(model, avatar)
    try:
        picture = Image.fromarray(in_motion(draper))
        picture.save(job.folder / PICTURE, quality=85)  # a tenth of a PNG: a page holds a thousand
    except PictureError as error:
        print(f"no picture: {error}")
    return check_garment(draper.layer, draper.avatar).as_plain_data()


def _print_into(log: Path) -> None:
    """Everything that this process prints from here on, from C++ and CUDA, too, is appended to the log."""
    file = open(log, "a", buffering=1)
    for stream in (1, 2):
        os.dup2(file.fileno(), stream)
    sys.stdout = sys.stderr = file


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
