"""What a catalogue run has to do: a job for each mesh or pattern of a folder, and how far each one is on disk.

All of it lies in the folder of models, so that a run that was stopped, or another one, goes on from there.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from physkin_core.mesh.mesh_file import SUFFIXES
from physkin_training.config import load_config
from physkin_training.fit_garment.sewn_mesh import PATTERN_SUFFIX
from physkin_training.train.checkpoint import checkpoint_step

__all__ = [
    "CHECKPOINT",
    "CatalogueError",
    "Job",
    "Stage",
    "Status",
    "find_jobs",
    "read_status",
    "stage",
    "steps_taken",
    "write_status",
]

RECIPE_SUFFIX = ".toml"
ALLOWED = (*SUFFIXES, PATTERN_SUFFIX)
STATUS, CHECKPOINT = "status.json", "checkpoint"

Stage = Literal["finished", "resumes", "new"]


class CatalogueError(ValueError):
    """A folder of garments cannot be trained."""


@dataclass(frozen=True)
class Job:
    """One garment. mesh: its file, or its pattern's. output: the model file to write. arguments: more of
    `physkin fit-garment`'s.

    avatar, rig: what it was made on and is looked at on; None for the body of the shipped garments. fingerprint: of all
    that the model depends on; a job that has another one is trained anew.
    """

    mesh: Path
    output: Path
    arguments: tuple[str, ...]
    fingerprint: str
    avatar: str | None = None
    rig: str | None = None

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
    went on from. check: of the trained garment on the avatar, as `physkin check --json` has it.
    """

    fingerprint: str
    state: Literal["training", "stopped", "finished", "failed"]
    reason: str = ""
    starts: int = 1
    resumed_at: list[int] = field(default_factory=list)
    check: dict | None = None


def find_jobs(
    folder: Path,
    output: Path,
    *,
    length: Sequence[str] = (),
    arguments: Sequence[str] = (),
    recipe: Path | None = None,
    avatar: str | None = None,
    rig: str | None = None,
) -> list[Job]:
    """A job for each mesh or pattern directly in the folder. A .toml of the same name is its recipe, in place of
    `recipe`.

    length, arguments: options of `physkin fit-garment`, of length and start of the training, and others; a garment
    trained with other ones of the former is trained anew. Raises CatalogueError for a folder without any, two of one
    name, or a .toml that belongs to none.
    """
    if not folder.is_dir():
        raise CatalogueError(f"{folder} is not a folder of garment meshes or patterns")
    files = sorted(path for path in folder.iterdir() if path.is_file())
    meshes: dict[str, Path] = {}
    for path in files:
        if path.suffix.lower() in ALLOWED:
            if path.stem in meshes:
                raise CatalogueError(
                    f"{meshes[path.stem]} and {path} would both become {path.stem}.safetensors: rename one"
                )
            meshes[path.stem] = path
    if not meshes:
        raise CatalogueError(f"{folder} holds no garment mesh or pattern; allowed: {', '.join(ALLOWED)}")
    recipes = {path.stem: path for path in files if path.suffix.lower() == RECIPE_SUFFIX}
    for name, path in recipes.items():
        if name not in meshes and not (recipe and recipe.resolve() == path.resolve()):
            raise CatalogueError(f"{path} belongs to no garment: there is no {name}{SUFFIXES[0]} beside it")
    common = [Path(name) for name in (avatar, rig) if name]
    jobs = []
    for name, mesh in meshes.items():
        own = recipes.get(name, recipe)
        more = [*length, *arguments, *(("--recipe", str(own.resolve())) if own else ())]
        read = [mesh, *common, *([own] if own else [])]
        jobs.append(
            Job(
                mesh.resolve(),
                (output / f"{name}.safetensors").resolve(),
                tuple(more),
                _fingerprint(read, length),
                avatar=avatar and str(Path(avatar).resolve()),
                rig=rig and str(Path(rig).resolve()),
            )
        )
    return jobs


def _fingerprint(files: Sequence[Path], length: Sequence[str]) -> str:
    digest = hashlib.sha256(json.dumps(list(length)).encode())
    for path in files:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
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


def stage(job: Job) -> Stage:
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
        return json.loads(last)["step"], load_config(job.folder / "config.toml").optimisation.steps
    except (OSError, ValueError, LookupError):
        return None
