"""What a catalogue run has to do: a job for each mesh or pattern of a folder, and how far each one is on disk.

All of it lies in the folder of models, so that a run that was stopped, or another one, goes on from there.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

from physkin_core.mesh.mesh_file import SUFFIXES
from physkin_training.config import load_config
from physkin_training.fit_garment.fit_garment import CONFIG
from physkin_training.fit_garment.settings import FitSettings
from physkin_training.fit_garment.sewn_mesh import PATTERN_SUFFIX
from physkin_training.train.checkpoint import checkpoint_step
from physkin_training.train.run import CHECKPOINT

__all__ = ["CatalogueError", "Job", "Status", "find_jobs", "read_status", "stage", "steps_taken", "write_status"]

FILES = ("avatar", "rig", "bones", "recipe")
ALLOWED = (*SUFFIXES, PATTERN_SUFFIX)
STATUS, LOG, PICTURE = "status.json", "log.txt", "picture.jpg"
"""In a garment's folder."""


class CatalogueError(ValueError):
    """A folder of garments cannot be trained."""


@dataclass(frozen=True)
class Job:
    """One garment. mesh: its file, or its pattern's. output: the model file to write. fingerprint: of all that the
    model depends on; a job that has another one is trained anew."""

    mesh: Path
    output: Path
    settings: FitSettings
    fingerprint: str

    @property
    def name(self) -> str:
        return self.output.stem

    @property
    def folder(self) -> Path:
        """Where fit-garment keeps what belongs to the garment."""
        return self.output.with_suffix("")


@dataclass(frozen=True)
class Status:
    """How far a job is.

    reason: why it failed. starts: how often it was begun or gone on with. resumed_at: steps of the checkpoints that it
    went on from. check: of the trained garment on the avatar, as `physkin check --json` has it. fitted: of the
    `FittedGarment`, all but the model.
    """

    fingerprint: str
    state: Literal["training", "stopped", "finished", "failed"]
    reason: str = ""
    starts: int = 1
    resumed_at: list[int] = field(default_factory=list)
    check: dict | None = None
    fitted: dict | None = None


def find_jobs(folder: Path, output: Path, settings: FitSettings) -> list[Job]:
    """A job for each mesh or pattern directly in the folder. A .toml of the same name is its recipe, in place of the
    settings'.

    Raises CatalogueError for a folder without any, two of one name, a .toml that belongs to none, and for an avatar,
    rig or recipe that is not there.
    """
    if not folder.is_dir():
        raise CatalogueError(f"{folder} is not a folder of garment meshes or patterns")
    given = {name: (value := getattr(settings, name)) and Path(value).resolve() for name in FILES}
    for name, path in given.items():
        if path and not path.is_file():
            raise CatalogueError(f"--{name} {path}: no such file")
    files = sorted(path for path in folder.iterdir() if path.is_file())
    meshes: dict[str, Path] = {}
    for path in files:
        if path.suffix.lower() in ALLOWED:
            if (other := meshes.setdefault(path.stem, path)) != path:
                raise CatalogueError(f"{other} and {path} would both become {path.stem}.safetensors: rename one")
    if not meshes:
        raise CatalogueError(f"{folder} holds no garment mesh or pattern; allowed: {', '.join(ALLOWED)}")
    recipes = {path.stem: path.resolve() for path in files if path.suffix.lower() == ".toml"}
    for name, path in recipes.items():
        if name not in meshes and path != given["recipe"]:
            raise CatalogueError(f"{path} belongs to no garment: there is no {name}{SUFFIXES[0]} beside it")
    jobs = []
    for name, mesh in meshes.items():
        texts = {option: str(path) if path else None for option, path in given.items()}
        of_job = replace(settings, **texts | {"recipe": recipes.get(name, given["recipe"])}, resume=True)
        path = (output / f"{name}.safetensors").resolve()
        jobs.append(Job(mesh.resolve(), path, of_job, _fingerprint(mesh, of_job)))
    return jobs


def _fingerprint(mesh: Path, settings: FitSettings) -> str:
    chosen = [settings.minutes, settings.steps, settings.start, settings.edge_length]
    digest = hashlib.sha256(json.dumps(chosen).encode())
    for path in (mesh, *filter(None, (getattr(settings, name) for name in FILES))):
        digest.update(hashlib.sha256(Path(path).read_bytes()).digest())
    return digest.hexdigest()


def read_status(job: Job) -> Status | None:
    """What was noted of the job, None where nothing was, or of another mesh or other settings."""
    try:
        status = Status(**json.loads((job.folder / STATUS).read_text()))
    except (OSError, ValueError, TypeError):
        return None
    return status if status.fingerprint == job.fingerprint else None


def write_status(job: Job, status: Status) -> None:
    """Note how far the job is, whole or not at all."""
    job.folder.mkdir(parents=True, exist_ok=True)
    partial = job.folder / f"{STATUS}.partial"
    partial.write_text(json.dumps(asdict(status), indent=1))
    partial.replace(job.folder / STATUS)


def stage(job: Job) -> Literal["finished", "resumes", "new"]:
    """Whether there is nothing left to do, something to go on from, or all to do."""
    status = read_status(job)
    if status is None:
        return "new"
    if status.state == "finished" and job.output.exists():
        return "finished"
    return "new" if checkpoint_step(job.folder / CHECKPOINT) is None else "resumes"


def steps_taken(job: Job) -> tuple[int, int] | None:
    """Steps that the training has recorded, and of how many; None before the first record."""
    try:
        last = (job.folder / "losses.jsonl").read_text().splitlines()[-1]
        return json.loads(last)["step"], load_config(job.folder / CONFIG).optimisation.steps
    except (OSError, ValueError, LookupError):
        return None
