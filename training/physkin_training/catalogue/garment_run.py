"""One garment of a catalogue, in a worker process of its own: checked, trained or gone on with, looked at, noted."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict, replace
from pathlib import Path

from PIL import Image

from physkin_core import BUNDLED_AVATAR, Draper, GarmentModel, load_avatar
from physkin_core.check.garment_check import check_garment
from physkin_core.pictures.picture import PictureError
from physkin_training.catalogue.plan import Job, Status, read_status, stage, write_status
from physkin_training.fit_garment.fit_garment import FIRST, PLACEMENT, fit_garment, log_progress
from physkin_training.fit_garment.pictures import in_motion
from physkin_training.train.checkpoint import checkpoint_step
from physkin_training.train.run import CHECKPOINT

__all__ = ["LOG", "PICTURE", "train_garment"]

LOG, PICTURE = "log.txt", "picture.jpg"


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
