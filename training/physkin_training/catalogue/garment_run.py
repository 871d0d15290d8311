"""One garment of a catalogue, in a worker process of its own: checked, trained or gone on with, looked at, noted."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model
from physkin_core.check.garment_check import check_garment
from physkin_core.pictures.picture import PictureError, contact_sheet
from physkin_core.render.filming import dressed_meshes
from physkin_training.catalogue.plan import CHECKPOINT, Job, Status, read_status, stage, write_status
from physkin_training.evaluate.contact_sheet import chosen_poses
from physkin_training.fit_garment import fit_garment
from physkin_training.fit_garment.report import front_and_back
from physkin_training.train.checkpoint import checkpoint_step

__all__ = ["LOG", "PICTURE", "train_garment"]

LOG, PICTURE = "log.txt", "picture.jpg"
INTERRUPTED = 130
TOLD = "error: "


def train_garment(job: Job, device: str) -> Status:
    """Check, train and report on the job's garment as `physkin fit-garment` does; go on where it was stopped.

    What it prints goes into the log in the garment's folder. A mesh that is refused, or training that fails, is a
    status, not an exception.
    """
    goes_on = stage(job) == "resumes"
    status = read_status(job) or Status(job.fingerprint, "training", starts=0)
    resumed_at = [*status.resumed_at, checkpoint_step(job.folder / CHECKPOINT)] if goes_on else []
    status = replace(status, state="training", reason="", starts=status.starts + 1, resumed_at=resumed_at)
    if not goes_on:  # of another mesh or other settings, perhaps
        for ending in ("", ".previous", ".partial"):
            shutil.rmtree(job.folder / f"{CHECKPOINT}{ending}", ignore_errors=True)
        for name in (PICTURE, fit_garment.FIGURES, fit_garment.FIRST, "placement.png", "losses.jsonl"):
            (job.folder / name).unlink(missing_ok=True)
    write_status(job, status)
    with _into(job.folder / LOG):
        try:
            code = fit_garment.main(_arguments(job, device))
            if code == 0:
                status = replace(status, check=_looked_at(job))
        except KeyboardInterrupt:
            code = INTERRUPTED
        except Exception as error:  # whatever happens to one garment, the others go on
            code = 1
            print(f"{TOLD}{type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
    if code == 0:
        status = replace(status, state="finished")
    elif code == INTERRUPTED:
        status = replace(status, state="stopped")
    else:
        status = replace(status, state="failed", reason=_reason(job.folder / LOG))
    write_status(job, status)
    return status


def _arguments(job: Job, device: str) -> list[str]:
    given = ["--avatar", job.avatar] if job.avatar else []
    given += ["--rig", job.rig] if job.rig else []
    return [str(job.mesh), "-o", str(job.output), "--resume", "--device", device, *given, *job.arguments]


def _looked_at(job: Job) -> dict:
    """Figures of the trained garment on the avatar, and its picture in a frame of motion."""
    model = load_garment_model(job.output)
    draper = Draper(model, load_avatar(job.avatar or BUNDLED_AVATAR, model.rig, rig_file=job.rig))
    poses, _ = chosen_poses(model.rig, count=2, seed=0)
    positions, gravity = poses.positions[1].numpy(), poses.gravity[1].numpy()
    body, garment = draper.outfit.posed_body(positions), draper.drape(positions, gravity)
    try:
        views = front_and_back(dressed_meshes(draper.outfit, body, [garment]))
        _save_jpeg(job.folder / PICTURE, contact_sheet(views, columns=2))
    except PictureError as error:
        print(f"no picture: {error}")
    return check_garment(draper.layer, draper.avatar).as_plain_data()


def _save_jpeg(path: Path, picture: np.ndarray) -> None:
    """A tenth of a PNG: a page holds a thousand."""
    from PIL import Image

    Image.fromarray(picture).save(path, quality=85)


def _reason(log: Path) -> str:
    """The last error in a log."""
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.startswith(TOLD)]
    return lines[-1].removeprefix(TOLD) if lines else f"see {log}"


@contextmanager
def _into(log: Path) -> Iterator[None]:
    """Everything that this process prints, from C++ and CUDA, too, is appended to the log."""
    streams = (sys.stdout, sys.stderr)
    kept = [os.dup(1), os.dup(2)]
    with open(log, "a", buffering=1) as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        sys.stdout = sys.stderr = file
        try:
            yield
        finally:
            sys.stdout, sys.stderr = streams
            for number, copy in zip((1, 2), kept):
                os.dup2(copy, number)
                os.close(copy)
