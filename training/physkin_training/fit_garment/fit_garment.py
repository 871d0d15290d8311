"""`physkin fit-garment`: from a garment mesh or a sewing pattern of one's own to a trained model and a report.

Sews a pattern, checks and repairs the mesh with verdicts in plain words, measures how fast this machine trains, trains
with the recipe of `TrainingConfig`, exports, lets the garment learn to sway, and writes a one-page HTML report: all in
the minutes given.
"""

from __future__ import annotations

import argparse
import logging
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.avatar.loading import load_avatar
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import save_garment_model
from physkin_core.outfit.outfit_options import print_warnings
from physkin_core.pictures.picture import PictureError, save_png
from physkin_training.compiled_kernels import compile_kernels
from physkin_training.config import as_toml, load_config
from physkin_training.devices import DEVICE_HELP, resolve_device
from physkin_training.fit_garment.checks import CheckedGarment, check_garment, write_garment
from physkin_training.fit_garment.file_objects import chosen_objects
from physkin_training.fit_garment.first_model import chosen_start, first_look, first_model, folds_verdict
from physkin_training.fit_garment.own_pose import OwnPose
from physkin_training.fit_garment.pictures import in_motion, placement_picture
from physkin_training.fit_garment.recipe import (
    LEARNING,
    SIMULATING,
    default_recipe,
    has_sizes_of,
    learns_sway,
    started_from,
    with_own_sway,
)
from physkin_training.fit_garment.report import write_report
from physkin_training.fit_garment.settings import FitSettings, add_fit_options
from physkin_training.fit_garment.sewn_mesh import EDGE_LENGTH, PATTERN_SUFFIX, sewn_mesh
from physkin_training.fit_garment.training_record import TrainingRecord
from physkin_training.fit_garment.training_time import plan_steps, seconds_for_training
from physkin_training.fit_garment.verdicts import Verdict, in_lines
from physkin_training.networks.export import ExportError
from physkin_training.time_budget import TimeBudget
from physkin_training.train.checkpoint import checkpoint_step
from physkin_training.train.fitted_weights import fitted_weights
from physkin_training.train.run import CHECKPOINT, trained_model
from physkin_training.train.trainer import Trainer, TrainingDiverged

__all__ = [
    "CONFIG",
    "FIRST",
    "PLACEMENT",
    "FittedGarment",
    "GarmentRefused",
    "command_parser",
    "fit_garment",
    "log_progress",
    "main",
]

log = logging.getLogger(__name__)
LEAST_TRAINING = 3.0
"""[s] Of training, however little time is left: of a start from a shipped garment most is learnt in it on a GPU."""
CONFIG, START, FIRST, PLACEMENT = "config.toml", "start.safetensors", "first.png", "placement.png"
"""In the run's folder: what `--resume` goes on with, and the model that training begins with; pictures of that and of
where the mesh lies."""


class GarmentRefused(Exception):
    """A mesh cannot be trained as a garment, or its place on the avatar is in doubt."""


@dataclass(frozen=True)
class FittedGarment:
    """A trained garment.

    verdicts: of the checks. figures: as of `physkin evaluate --json`. advice: whether to train longer, in words.
    undertrained: what is to be said of a model that has not learnt enough to be used, "" of one that has. seconds: of
    training, with all times that it was resumed.
    """

    model: GarmentModel
    verdicts: tuple[Verdict, ...]
    figures: dict
    advice: str
    undertrained: str
    seconds: float


def main(argv: list[str] | None = None) -> int:
    """Command line entry. Returns 0; 1 when the mesh is refused, its place in doubt or training fails. Raises
    ValueError or OSError for bad input, KeyboardInterrupt for Ctrl-C."""
    options = command_parser().parse_args(argv)
    log_progress()
    try:
        fitted = fit_garment(options.garment, options.output, FitSettings.of(options))
    except (GarmentRefused, TrainingDiverged, ExportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if fitted and fitted.undertrained:
        print(f"{options.output} is undertrained. {fitted.undertrained}", file=sys.stderr)
    return 0


def log_progress() -> None:
    """What training says goes to standard error, but nothing of each body that the garment is put on."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    logging.getLogger("physkin_training").setLevel(logging.INFO)


def command_parser() -> argparse.ArgumentParser:
    description = "Check, repair and train a garment mesh or a sewing pattern of your own, and write a report."
    parser = argparse.ArgumentParser(prog="physkin fit-garment", description=description)
    parser.add_argument(
        "garment", type=Path, help="garment mesh: OBJ, PLY, STL, OFF, GLB or glTF; or a sewing pattern: JSON"
    )
    parser.add_argument(
        *("-o", "--output"),
        type=Path,
        required=True,
        metavar="NAME.safetensors",
        help="garment model to write; NAME.html is the report, and all else goes into the folder NAME",
    )
    add_fit_options(parser)
    parser.add_argument(
        "--object",
        dest="objects",
        action="append",
        metavar="NAME",
        help="of a mesh file only the object of this name, or its connected piece of this number where it names none; "
        "may be given several times",
    )
    parser.add_argument(
        "--check-only",
        action="store_true",
        help="stop after the checks: print the verdicts, write the repaired mesh and a picture",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="continue from the checkpoint of a stopped run, if there is one, with its steps and recipe",
    )
    parser.add_argument("--device", help=DEVICE_HELP)
    return parser


def fit_garment(source: Path, output: Path, settings: FitSettings) -> FittedGarment | None:
    """Make a garment model of a mesh or a sewing pattern.

    Args:
        source: mesh file or pattern.
        output: NAME.safetensors, the model: before training the first one, later the trained one. NAME.html is the
            report; the folder NAME gets the repaired mesh and what is needed to go on after a stop.
        settings: everything else.

    Returns:
        The garment; None where it was only checked.

    Raises:
        GarmentRefused: with what was found and what is allowed.
        ValueError: for files and settings that cannot be used.
        TrainingDiverged, ExportError: when training fails.
        KeyboardInterrupt: for Ctrl-C, after a checkpoint.
    """
    if output.suffix != ".safetensors" or not re.fullmatch(r"\w[\w. -]*", output.stem):
        raise ValueError(f"cannot write {output}: the name must be a plain one that ends in .safetensors")
    device = resolve_device(settings.device)
    budget, folder = TimeBudget(settings.time_on(device)), output.with_suffix("")
    body_model = load_body_model()
    template = avatar_from_body(body_model, body_model.garment_body)
    avatar = _avatar(settings, body_model) if settings.avatar else template
    pattern = source.suffix.lower() == PATTERN_SUFFIX
    if settings.edge_length is not None and not pattern:
        raise ValueError(f"--edge-length belongs to a sewing pattern ({PATTERN_SUFFIX}); {source} is a mesh")
    if settings.objects and pattern:
        raise ValueError(f"--object belongs to a mesh; {source} is a sewing pattern")
    if not settings.check_only:
        budget.uncounted(partial(compile_kernels, device))
    if pattern:
        edge_length = EDGE_LENGTH if settings.edge_length is None else settings.edge_length
        mesh = sewn_mesh(source, avatar, body_model.rig, edge_length=edge_length, device=device)
    else:
        mesh = read_mesh(source)
        if settings.objects:
            mesh = chosen_objects(mesh, settings.objects)
    own = None if pattern or not settings.avatar else OwnPose.of(avatar, avatar.file_vertices, body_model.rig)
    accept, chosen = settings.accept_placement, bool(settings.objects)
    checked = check_garment(mesh, avatar, template, own=own, accept_placement=accept, chosen=chosen, sewn=pattern)
    place = partial(_draw_placement, folder / PLACEMENT, avatar=avatar, own=own)
    _refuse(source, checked, settings, place)
    likeness, verdict = chosen_start(checked.garment, settings.start)
    checked = replace(checked, verdicts=(*checked.verdicts, verdict))
    print(in_lines(checked.verdicts))
    if verdict.outcome == "ok":
        print(f"{verdict.check}: {verdict.found}")
    if settings.check_only or checked.first("unsure"):
        place(checked, template)
    if settings.check_only:
        _write_mesh(folder, checked)
        return None
    model = first_model(checked.garment, likeness, name=output.stem)
    if likeness is not None:
        folds = folds_verdict(checked.garment, model)
        print(f"{folds.check}: {folds.found}")
        checked = replace(checked.moved(model.garment.vertices), verdicts=(*checked.verdicts, folds))
    record = TrainingRecord(folder / "losses.jsonl")
    trainer = _resumed(checked, folder, device) if settings.resume else None
    resumed = trainer is not None
    if not resumed:
        record.path.unlink(missing_ok=True)
        trainer = _begun(settings, checked, model, output, device, budget, avatar)
    start, earlier = trainer.start, record.seconds
    after = SIMULATING + LEARNING if learns_sway(start, model, device, seconds=budget.seconds) else 0.0
    if resumed:
        budget = TimeBudget()
    else:
        if not settings.steps:
            plan_steps(trainer, budget, after=after)
        (folder / CONFIG).write_text(as_toml(trainer.config))
    began = budget.spent
    within = max(seconds_for_training(budget, after), LEAST_TRAINING)
    often = settings.checkpoint_every
    trained = trained_model(trainer, folder, output, within=within, checkpoint_every=often, shown=True)
    del trainer  # the report needs its memory
    seconds, sway = earlier + budget.spent - began, ""
    if after:
        within = max(seconds_for_training(budget, LEARNING), SIMULATING)
        trained, sway = with_own_sway(trained, device, within=within)
        print(sway)
        save_garment_model(trained, output)
    worn = avatar if settings.avatar else None
    sizes = {"bodies": settings.bodies, "poses": settings.poses}
    figures = write_report(
        output, trained, checked, template, worn, device, budget, record=record, sway=sway, seconds=seconds, **sizes
    )
    print(f"wrote {output} and {output.with_suffix('.html')}, {budget.spent / 60:.1f} minutes in all")
    undertrained = record.undertrained(figures, begun=start is not None)
    advice = f"Undertrained. {undertrained}" if undertrained else record.longer_or_not()
    return FittedGarment(trained, checked.verdicts, figures, advice, undertrained, seconds)


def _avatar(settings: FitSettings, body_model: BodyModel) -> Avatar:
    """The avatar that the garment was made on, in the canonical pose."""
    avatar = load_avatar(settings.avatar, body_model.rig, rig_file=settings.rig, bones=settings.bones)
    print_warnings(avatar.warnings)
    return avatar


def _refuse(
    source: Path, checked: CheckedGarment, settings: FitSettings, place: Callable[[CheckedGarment, None], Path]
) -> None:
    """Raises GarmentRefused for a garment that is, and for one whose place is in doubt, which `place` draws."""
    if refused := checked.first("refused"):
        print(in_lines([verdict for verdict in checked.verdicts if verdict is not refused]))
        raise GarmentRefused(
            f"{source} cannot be trained: {refused.check}: {refused.found}; allowed: {refused.allowed}"
        )
    unsure = checked.first("unsure")
    if unsure and not settings.accept_placement:
        print(in_lines(checked.verdicts))
        picture = place(checked, None)
        raise GarmentRefused(
            f"{source}: {unsure.check} is in doubt: {unsure.found}. Export garment and avatar from one scene, with one "
            f"origin, unit and up axis; or, if {picture} is right, --accept-placement"
        )


def _draw_placement(
    path: Path, checked: CheckedGarment, template: Avatar | None, *, avatar: Avatar, own: OwnPose | None
) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        save_png(path, placement_picture(checked, avatar, template, own))
        print(f"wrote {path}: look whether front, height and sleeves are right")
    except PictureError as error:
        print(f"no picture: {error}")
    return path


def _write_mesh(folder: Path, checked: CheckedGarment) -> Path:
    """Write the repaired mesh into the folder."""
    path = folder / "garment.obj"
    folder.mkdir(parents=True, exist_ok=True)
    write_garment(path, checked)
    print(f"wrote {path}" + (f" with {checked.look}" if str(checked.look) else ""))
    return path


def _resumed(checked: CheckedGarment, folder: Path, device: torch.device) -> Trainer | None:
    """A trainer that goes on from what a stopped run left in its folder; None where there is nothing."""
    checkpoint, configuration = folder / CHECKPOINT, folder / CONFIG
    if not configuration.exists() or checkpoint_step(checkpoint) is None:
        return None
    trainer = Trainer(load_config(configuration), device, garment=checked.garment)
    trainer.resume(checkpoint)
    return trainer


def _begun(
    settings: FitSettings,
    checked: CheckedGarment,
    model: GarmentModel,
    output: Path,
    device: torch.device,
    budget: TimeBudget,
    avatar: Avatar,
) -> Trainer:
    """A trainer before its first step. What can be worn before training is written as `output`, and what a run is
    resumed with into the folder. model: the first one, which training begins with where it has the recipe's sizes."""
    folder, body_model, name = output.with_suffix(""), load_body_model(), output.stem
    mesh = _write_mesh(folder, checked)
    (folder / CHECKPOINT).unlink(missing_ok=True)
    if settings.recipe:
        recipe = load_config(settings.recipe, name=name, garment=mesh)
    else:
        recipe = default_recipe(name, mesh, device, seconds=budget.seconds)
    start = None
    if "transferred_from" in model.training:
        model = fitted_weights(model, body_model, device)
        if has_sizes_of(recipe, model):
            start, recipe = model, started_from(recipe, folder / START)
            save_garment_model(start, recipe.start)
        else:
            log.warning("training begins with nothing: %s has other sizes than %s", settings.recipe, model.name)
    save_garment_model(model, output)
    trust, draper = first_look(model, avatar, body_model)
    print(f"wrote {output}, to be worn while it trains: {trust}")
    try:
        save_png(folder / FIRST, in_motion(draper))
        print(f"wrote {folder / FIRST}")
    except PictureError as error:
        print(f"no picture: {error}")
    if settings.steps:
        recipe = replace(recipe, optimisation=replace(recipe.optimisation, steps=settings.steps))
    return Trainer(recipe, device, garment=checked.garment, start=start)
