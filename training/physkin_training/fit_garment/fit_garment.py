"""`physkin fit-garment`: from a garment mesh or a sewing pattern of one's own to a trained model and a report.

Sews a pattern, checks and repairs the mesh with verdicts in plain words, measures how fast this machine trains, trains
with the recipe of `TrainingConfig`, exports, lets the garment learn to sway, and writes a one-page HTML report: all in
the minutes given.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import torch

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.avatar.loading import load_avatar
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.model.garment import load_garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_core.outfit.outfit_options import print_warnings
from physkin_core.pictures.picture import PictureError, contact_sheet, save_png
from physkin_training.config import TrainingConfig, as_toml, load_config
from physkin_training.fit_garment.checks import CheckedGarment, check_garment, write_garment
from physkin_training.fit_garment.first_model import chosen_start, first_look, first_model, folds_verdict
from physkin_training.fit_garment.options import ADVICE, DEFAULT_MINUTES, FEWEST_STEPS, checked_device, command_parser
from physkin_training.fit_garment.own_pose import OwnPose
from physkin_training.fit_garment.recipe import (
    LEARNING,
    SIMULATING,
    STEPS_A_SECOND,
    default_recipe,
    has_sizes_of,
    in_a_hurry,
    learns_sway,
    started_from,
    with_own_sway,
)
from physkin_training.fit_garment.report import placement_picture, write_report
from physkin_training.fit_garment.sewn_mesh import EDGE_LENGTH, PATTERN_SUFFIX, sewn_mesh
from physkin_training.fit_garment.training_record import longer_or_not, read_losses, recorded_seconds, undertrained
from physkin_training.fit_garment.verdicts import in_lines
from physkin_training.time_budget import TimeBudget
from physkin_training.train import train
from physkin_training.train.checkpoint import checkpoint_step
from physkin_training.train.trainer import Trainer

__all__ = ["FIGURES", "FIRST", "main", "trainer_in_time"]

log = logging.getLogger(__name__)
REST, LONGEST_REST = 0.25, 150.0
"""Time kept for what follows training: share of all, and seconds at most. The report draws and measures less where that
is too little."""
MEASURING = 0.1
"""Share of the time in which steps are timed."""
FEWEST_SECONDS = 10.0
"""Of training, where a length is advised."""
LEAST_TRAINING = 3.0
"""[s] Of training, however little time is left: of a start from a shipped garment most is learnt in it on a GPU."""
OFTEN = {"cuda": 10, "cpu": 1}
"""Steps from one line of the record to the next, at least."""
FIRST, START = "first.png", "start.safetensors"
"""In the run's folder: a picture of the model before training, and the model."""
REFUSED = 1
FIGURES = "figures.json"
"""In the run's folder: `seconds` of training, `checks`, `figures` as of `physkin evaluate --json`, `advice`."""


def trainer_in_time(config: TrainingConfig, device: torch.device, budget: TimeBudget, *, after: float = 0.0) -> Trainer:
    """A trainer of as many steps as leave time in the budget for export and report (see `REST`), and for what takes so
    many seconds after training. Real steps are timed for it, but for one in a hurry: it plans for some, and training
    leaves out what there is no time for.

    Raises ValueError when they are too few to learn anything.
    """
    trainer = Trainer(config, device)
    seconds = _for_training(budget, after)
    if in_a_hurry(device, budget.seconds):
        steps = max(FEWEST_STEPS, int(STEPS_A_SECOND * seconds))
        trainer.config = replace(config, optimisation=replace(config.optimisation, steps=steps))
        log.info("%.0f s are left for training: %d steps, or as many as that time allows", max(seconds, 0.0), steps)
        return trainer
    minutes = f"{budget.seconds / 60:g} minutes in all"
    if seconds <= 0:
        raise ValueError(
            f"{minutes} are too few: {budget.spent:.0f} s went by before training, and "
            f"{budget.left - seconds:.0f} s are kept for {'sway, ' if after else ''}export and report: {ADVICE}, of "
            f"--minutes about {math.ceil((budget.spent + FEWEST_SECONDS + after) / (1 - REST) / 60)}"
        )
    try:
        rate = trainer.choose_steps(seconds)
    except ValueError as error:
        raise ValueError(f"{minutes} leave {seconds:.0f} s for training, and {error}: {ADVICE}") from error
    steps = trainer.config.optimisation.steps
    if steps < FEWEST_STEPS:
        missing = (FEWEST_STEPS - steps) / rate / (1 - REST - MEASURING)
        raise ValueError(
            f"{minutes} are only {steps} steps of {1 / rate:.2f} s here, at least {FEWEST_STEPS} are needed: {ADVICE}, "
            f"of --minutes about {math.ceil((budget.seconds + missing) / 60)}"
        )
    log.info("%d steps of %.0f ms in %s, export and report included", steps, 1000 / rate, minutes)
    return trainer


def _for_training(budget: TimeBudget, after: float) -> float:
    """Seconds for training. after: [s] kept for what follows it beside export and report."""
    return budget.left - min(REST * budget.seconds, LONGEST_REST) - after


def main(argv: list[str] | None = None) -> int:
    """Command line entry. Returns 0; 1 when the mesh is refused, its place in doubt or training fails; 2 for an error;
    130 for Ctrl-C."""
    options = command_parser().parse_args(argv)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    logging.getLogger("physkin_training").setLevel(logging.INFO)  # not each body that the garment is put on
    try:
        return _fit(options)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _fit(options: argparse.Namespace) -> int:
    output: Path = options.output
    device = checked_device(options)
    minutes = math.inf if options.steps else options.minutes or DEFAULT_MINUTES[device.type]
    budget = TimeBudget(minutes)
    body_model = load_body_model()
    template = avatar_from_body(body_model, body_model.garment_body)
    avatar, own = _avatar(options, body_model, template)
    pattern = options.garment.suffix.lower() == PATTERN_SUFFIX
    if options.edge_length is not None and not pattern:
        raise ValueError(f"--edge-length belongs to a sewing pattern ({PATTERN_SUFFIX}); {options.garment} is a mesh")
    if pattern:
        edge_length = EDGE_LENGTH if options.edge_length is None else options.edge_length
        mesh, own = sewn_mesh(options.garment, avatar, body_model.rig, edge_length=edge_length, device=device), None
    else:
        mesh = read_mesh(options.garment)
    checked = check_garment(mesh, avatar, template, own=own, accept_placement=options.accept_placement)
    if checked.refused:
        refused = checked.first("refused")
        print(in_lines([verdict for verdict in checked.verdicts if verdict is not refused]))
        print(
            f"error: {options.garment} cannot be trained: {refused.check}: {refused.found}; allowed: {refused.allowed}",
            file=sys.stderr,
        )
        return REFUSED
    folder = output.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "placement.png"
    unsure = checked.first("unsure")
    if unsure and not options.accept_placement:
        print(in_lines(checked.verdicts))
        _draw(picture, checked, avatar, None, own)
        print(
            f"error: {options.garment}: {unsure.check} is in doubt: {unsure.found}. Export garment and avatar from one "
            f"scene, with one origin, unit and up axis; or, if {picture} is right, --accept-placement",
            file=sys.stderr,
        )
        return REFUSED
    mesh = folder / "garment.obj"
    write_garment(mesh, checked)
    garment = load_garment(mesh)
    likeness, verdict = chosen_start(garment, getattr(options, "from"))
    checked = replace(checked, verdicts=(*checked.verdicts, verdict))
    print(in_lines(checked.verdicts))
    if verdict.outcome == "ok":
        print(f"{verdict.check}: {verdict.found}")
    kept = f" with {checked.look}" if str(checked.look) else ""
    print(f"wrote {mesh}{kept}")
    if unsure or options.check_only:
        _draw(picture, checked, avatar, template, own)
    if options.check_only:
        return 0
    model = first_model(mesh, likeness, body_model, device, name=output.stem)
    if likeness is not None:
        folds = folds_verdict(garment, model)
        print(f"{mesh}: {folds.found}")
        checked = replace(checked, vertices=model.garment.vertices, verdicts=(*checked.verdicts, folds))
        write_garment(mesh, checked)
    return _train_and_report(options, checked, mesh, model, template, avatar, device, budget)


def _draw(path: Path, checked: CheckedGarment, avatar: Avatar, template: Avatar | None, own: OwnPose | None) -> None:
    try:
        save_png(path, placement_picture(checked, avatar, template, own))
        print(f"wrote {path}: look whether front, height and sleeves are right")
    except PictureError as error:
        print(f"no picture: {error}")


def _avatar(options: argparse.Namespace, body_model: BodyModel, template: Avatar) -> tuple[Avatar, OwnPose | None]:
    """The body that the garment was made on, in the canonical pose, and in its own where a file was given."""
    if not options.avatar:
        return template, None
    avatar = load_avatar(options.avatar, body_model.rig, rig_file=options.rig)
    print_warnings(avatar.warnings)
    return avatar, OwnPose.of(avatar, avatar.file_vertices, body_model.rig)


def _train_and_report(
    options: argparse.Namespace,
    checked: CheckedGarment,
    mesh: Path,
    model: GarmentModel,
    template: Avatar,
    avatar: Avatar,
    device: torch.device,
    budget: TimeBudget,
) -> int:
    output, folder = options.output, mesh.parent
    configuration, losses, checkpoint = folder / "config.toml", folder / "losses.jsonl", folder / "checkpoint"
    resumed = options.resume and configuration.exists() and checkpoint_step(checkpoint) is not None
    if resumed:
        config = load_config(configuration)
    else:
        _show_first(options, mesh, model, avatar)
        config = _configuration(options, mesh, model, device, budget)
    sways = learns_sway(config, model, device, seconds=budget.seconds)
    after = SIMULATING + LEARNING if sways else 0.0
    if resumed:
        trainer, earlier, budget = None, recorded_seconds(losses), TimeBudget()
    else:
        trainer = None if options.steps else trainer_in_time(config, device, budget, after=after)
        config, earlier = trainer.config if trainer else config, 0.0
        configuration.write_text(as_toml(config))
        losses.unlink(missing_ok=True)
    began = budget.spent
    arguments = ["--config", str(configuration), "--output", str(folder), "--device", options.device]
    often = OFTEN[device.type]
    arguments += ["--log-every", str(max(often, min(200, config.optimisation.steps // 200)))]
    arguments += ["--checkpoint-every", str(options.checkpoint_every)]
    arguments += ["--resume", str(checkpoint)] if resumed else []
    within = max(_for_training(budget, after), LEAST_TRAINING)
    status = train.main(arguments, within=within, shown=output, trainer=trainer)
    del trainer  # the report needs its memory
    if status:
        return status
    seconds = earlier + budget.spent - began
    (folder / f"{config.name}.safetensors").replace(output)
    trained, sway = load_garment_model(output), ""
    if sways:
        within = max(_for_training(budget, LEARNING), SIMULATING)
        trained, sway = with_own_sway(trained, device, within=within)
        print(sway)
        save_garment_model(trained, output)
    report = output.with_suffix(".html")
    scores = write_report(
        report,
        trained,
        checked,
        template,
        avatar if options.avatar else None,
        device,
        budget,
        losses=losses,
        sway=sway,
        seconds=seconds,
        bodies=options.bodies,
        poses=options.poses,
    )
    found = {"seconds": seconds, "checks": [vars(verdict) for verdict in checked.verdicts]}
    rows = read_losses(losses)
    too_short = undertrained(scores, rows[-1]["step"], begun=config.start is not None)
    advice = f"Undertrained. {too_short}" if too_short else longer_or_not(rows)
    found |= {"figures": scores, "advice": advice}
    (folder / FIGURES).write_text(json.dumps(found, indent=1))
    print(f"wrote {output} and {report}, {budget.spent / 60:.1f} minutes in all")
    if too_short:
        print(f"{output} is undertrained. {too_short}", file=sys.stderr)
    return 0


def _show_first(options: argparse.Namespace, mesh: Path, model: GarmentModel, avatar: Avatar) -> None:
    """Write what can be worn before training, and a picture of it; says how good it is."""
    output, picture = options.output, mesh.with_name(FIRST)
    save_garment_model(model, output)
    look = first_look(model, avatar, load_body_model())
    print(f"wrote {output}, to be worn while it trains: {look}")
    try:
        save_png(picture, contact_sheet(look.picture(), columns=2))
        print(f"wrote {picture}")
    except PictureError as error:
        print(f"no picture: {error}")


def _configuration(
    options: argparse.Namespace, mesh: Path, start: GarmentModel, device: torch.device, budget: TimeBudget
) -> TrainingConfig:
    """Of a new run: the recipe, with as many steps as were asked for."""
    name = options.output.stem
    if options.recipe:
        recipe = load_config(options.recipe, name=name, garment=mesh)
    else:
        recipe = default_recipe(name, mesh, device, seconds=budget.seconds)
    carried = "carried_from" in start.training
    if carried and has_sizes_of(recipe, start):
        beside = mesh.with_name(START)
        shutil.copyfile(options.output, beside)  # as `_show_first` wrote it
        recipe = started_from(recipe, beside)
    elif carried:
        log.warning("training begins with nothing: %s has other sizes than %s", options.recipe, start.name)
    if not options.steps:
        return recipe
    return replace(recipe, optimisation=replace(recipe.optimisation, steps=options.steps))


if __name__ == "__main__":
    raise SystemExit(main())
