"""`physkin train`: learn a garment from its mesh and physics, with checkpoints, TensorBoard scalars and export."""

from __future__ import annotations

import argparse
import logging
import math
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.hyper_modulator import BENDING_OCTAVES
from physkin_core.model.model_file import load_garment_model, save_garment_model
from physkin_training.config import ConfigError, load_config
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP
from physkin_training.networks.carried_sway import carried_sway
from physkin_training.networks.export import ExportError, model_from_drape, store_checked
from physkin_training.networks.rest_normals import fitted_rest_normals
from physkin_training.rounding.rounded_model import rounded_model
from physkin_training.train.checkpoint import CheckpointError, saved_steps
from physkin_training.train.processes import join, leave
from physkin_training.train.run_reports import RunReports
from physkin_training.train.trainer import Trainer, TrainingDiverged

__all__ = ["command_parser", "export", "main"]

log = logging.getLogger(__name__)
INTERRUPTED = 130
SHOWN_EVERY = 30.0
"""[s] At least, from one model that is written on the way to the next."""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin train`."""
    parser = argparse.ArgumentParser(prog="physkin train", description=__doc__.split("`: ", 1)[1])
    parser.add_argument("--config", type=Path, required=True, help="training configuration (TOML)")
    parser.add_argument(
        "--garment",
        type=Path,
        metavar="MESH",
        help="garment mesh, instead of the configuration's; the model gets its name",
    )
    parser.add_argument("--output", type=Path, required=True, help="folder for checkpoint, scalars and the model")
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--resume", type=Path, metavar="FOLDER", help="continue from the checkpoint in this folder")
    start.add_argument(
        "--start-from", type=Path, metavar="PATH", help="start a new run from the networks of this checkpoint or model"
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument(
        "--minutes",
        type=_finite_minutes,
        help="choose the number of steps so that the run takes this long (give it again with --resume)",
    )
    parser.add_argument(
        "--stop-after",
        type=_minutes,
        default=math.inf,
        metavar="MINUTES",
        help="write a checkpoint and stop after so many minutes",
    )
    parser.add_argument(
        "--checkpoint-every",
        type=_minutes,
        default=5.0,
        metavar="MINUTES",
        help="minutes between checkpoints (default 5; inf: only at the end)",
    )
    parser.add_argument(
        "--log-every", type=_steps, default=200, metavar="STEPS", help="steps between lines of the log (default 200)"
    )
    return parser


def main(
    argv: list[str] | None = None,
    *,
    within: float = math.inf,
    shown: Path | None = None,
    trainer: Trainer | None = None,
) -> int:
    """Command line entry. within: seconds of training; where the run would take longer, steps are left out on the way
    (in one process). shown: where the best model so far is written now and then while it trains, and at the end before
    it is rounded. trainer: of the configuration, on the device, before its first step; it is made here by default."""
    arguments = command_parser().parse_args(argv)
    try:
        garment = arguments.garment
        config = load_config(arguments.config, name=garment and garment.stem, garment=garment)
        processes, device = join(arguments.device)
        logging.basicConfig(level=logging.INFO if processes.writes else logging.WARNING, format="%(message)s")
        if arguments.minutes and arguments.resume:
            config = replace(config, optimisation=replace(config.optimisation, steps=saved_steps(arguments.resume)))
        trainer = trainer or Trainer(config, device, processes=processes)
        if trainer.garment.panel_places is not None:
            area = trainer.garment.face_areas.sum()
            log.info("%s rests as the flat panels of its texture coordinates, %.3f m2", config.garment.name, area)
        if arguments.resume:
            trainer.resume(arguments.resume)
        elif arguments.start_from:
            trainer.start_from(arguments.start_from)
        if arguments.minutes and not arguments.resume:
            rate = trainer.choose_steps(60 * arguments.minutes)
            steps = trainer.config.optimisation.steps
            log.info("%.1f steps a second: %d steps in %g minutes", rate, steps, arguments.minutes)
    except (ConfigError, CheckpointError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    arguments.output.mkdir(parents=True, exist_ok=True)
    checkpoint = arguments.output / "checkpoint"
    try:
        stopped = _train(trainer, arguments, checkpoint, within, shown)
        trainer.save(checkpoint)
    except TrainingDiverged as error:
        kept = f"; {checkpoint} is from before, start from it with a lower learning rate" if checkpoint.exists() else ""
        print(f"error: {error}{kept}", file=sys.stderr)
        return 1
    except CheckpointError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    trainer.close()
    leave()
    if stopped is not None:
        log.info("stopped at step %d; go on with --resume %s", trainer.step, checkpoint)
        return stopped
    if not processes.writes:
        return 0
    path = arguments.output / f"{config.name}.safetensors"
    try:
        export(trainer, path, shown=shown)
    except ExportError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    log.info("%s: %.2f MB", path, path.stat().st_size / 1e6)
    return 0


def _minutes(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} must be above 0 minutes")
    return value


def _finite_minutes(text: str) -> float:
    value = _minutes(text)
    if value == math.inf:
        raise argparse.ArgumentTypeError(f"{text} must be finite")
    return value


def _steps(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} must be at least 1 step")
    return value


class _Interrupt:
    """Ctrl-C lets the running step finish, so that the checkpoint is exact; a second one stops at once."""

    def __init__(self) -> None:
        self.requested = False

    def __enter__(self) -> _Interrupt:
        self._previous = signal.signal(signal.SIGINT, self._request)
        return self

    def __exit__(self, *_) -> None:
        signal.signal(signal.SIGINT, self._previous)

    def _request(self, *_) -> None:
        self.requested = True
        signal.signal(signal.SIGINT, self._previous)


def _train(
    trainer: Trainer, arguments: argparse.Namespace, checkpoint: Path, within: float, shown: Path | None
) -> int | None:
    """Run to the end (returns None), until the time is up or until Ctrl-C (returns the exit status)."""
    steps = trainer.config.optimisation.steps
    saved = written = time.perf_counter()
    best = trainer.best
    with RunReports(trainer, arguments.output, every=arguments.log_every) as reports, _Interrupt() as interrupt:
        for step in trainer.run(steps):
            report = step % arguments.log_every == 0 or step == steps or trainer.settled
            late = report and step < steps and reports.seconds > 60 * arguments.stop_after
            due = time.perf_counter() - saved > 60 * arguments.checkpoint_every
            interrupted, due, late = trainer.processes.any(interrupt.requested, due, late)
            if interrupted:
                return INTERRUPTED
            if due:
                trainer.save(checkpoint)
                saved = time.perf_counter()
            better = trainer.best is not best and trainer.best.step > 0  # at 0 it is what is shown already
            if shown and better and time.perf_counter() - written > SHOWN_EVERY:
                save_garment_model(_best_model(trainer), shown)
                best, written = trainer.best, time.perf_counter()
            if report:
                reports.report()
                if step < steps and not trainer.settled:
                    on_time = int(steps * reports.seconds / within)
                    trainer.skip_to(max(step, min(on_time, steps - 1)))
            if late:
                return 0
    if trainer.settled:
        waited = trainer.config.optimisation.patience
        log.info(
            "%d measurements found no lower energy than that of step %d: training ends here", waited, trainer.best.step
        )
    return None


def export(trainer: Trainer, path: Path, *, shown: Path | None = None) -> GarmentModel:
    """Write the model of the run's best drape, and return it. shown: where it is written at once, not rounded. Raises
    ExportError, and writes nothing as `path`, when it drapes otherwise, rounded as finely as can be."""
    drape = trainer.best_drape()
    if best := trainer.best:
        log.info("the model is the one of step %d, with the lowest validation energy, %.4f J", best.step, best.energy)
    model = _best_model(trainer)
    if shown:
        save_garment_model(model, shown)
        log.info("wrote %s as it was trained; now it is rounded, compared and measured", shown)
    model = replace(model, rest_normals=fitted_rest_normals(drape, trainer.garment, trainer.rig))
    try:
        return store_checked(rounded_model(model, device=trainer.device), drape, path)
    except ExportError as error:
        log.info("%s: rounded more finely", error)
    return store_checked(rounded_model(model, device=trainer.device, finely=True), drape, path)


def _best_model(trainer: Trainer) -> GarmentModel:
    """Of the run's best drape, with the mesh's normals, network weights as they are, and the sway of what it began
    with."""
    config, best = trainer.config, trainer.best
    training = config.as_plain_data() | {"step": best.step if best else trainer.step}
    training["bending_octaves"] = list(BENDING_OCTAVES)
    if best:
        training["validation_energy_j"] = best.energy
    if trainer.started_from:
        training["started_from"] = trainer.started_from
    model = model_from_drape(
        trainer.best_drape(),
        trainer.garment,
        trainer.rig,
        name=config.name,
        influences=config.garment_nodes.influences,
        engine_influences=config.garment_nodes.engine_influences,
        material=config.material,
        training=training,
    )
    start = config.start and load_garment_model(config.start)
    if start and start.sway is not None:
        model = replace(model, sway=carried_sway(start, model, trainer.body_model, trainer.device))
    return model


if __name__ == "__main__":
    raise SystemExit(main())
