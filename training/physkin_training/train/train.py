"""`physkin train`: learn a garment from its mesh and physics, with checkpoints, TensorBoard scalars and export."""

from __future__ import annotations

import argparse
import logging
import math
import sys
from dataclasses import replace
from pathlib import Path

from physkin_training.config import load_config
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.networks.export import ExportError
from physkin_training.train.checkpoint import saved_steps
from physkin_training.train.run import trained_model
from physkin_training.train.trainer import Trainer, TrainingDiverged

__all__ = ["command_parser", "main"]

log = logging.getLogger(__name__)


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
    start.add_argument("--resume", type=Path, metavar="FILE", help="continue from this checkpoint")
    start.add_argument(
        "--start-from", type=Path, metavar="PATH", help="start a new run from the networks of this checkpoint or model"
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument(
        "--minutes",
        type=_minutes,
        help="choose the number of steps so that the run takes this long (give it again with --resume)",
    )
    return parser


def main(argv: list[str] | None = None) -> int:
    """Command line entry. Returns 0; 1 when training fails. Raises ValueError or OSError for bad input,
    KeyboardInterrupt for Ctrl-C."""
    arguments = command_parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    trainer, within = _trainer(arguments)
    output = arguments.output / f"{trainer.config.name}.safetensors"
    try:
        trained_model(trainer, arguments.output, output, within=within)
    except (TrainingDiverged, ExportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _trainer(arguments: argparse.Namespace) -> tuple[Trainer, float]:
    """As the options say, at the first steps of the run or where it goes on, and the seconds that it has from there.
    Raises ValueError."""
    garment, minutes = arguments.garment, arguments.minutes
    config = load_config(arguments.config, name=garment and garment.stem, garment=garment)
    if minutes and arguments.resume:
        config = replace(config, optimisation=replace(config.optimisation, steps=saved_steps(arguments.resume)))
    trainer = Trainer(config, resolve_device(arguments.device))
    if trainer.garment.panel_places is not None:
        area = trainer.garment.face_areas.sum()
        log.info("%s rests as the flat panels of its texture coordinates, %.3f m2", config.garment.name, area)
    if arguments.resume:
        trainer.resume(arguments.resume)
        return trainer, math.inf
    if arguments.start_from:
        trainer.start_from(arguments.start_from)
    if not minutes:
        return trainer, math.inf
    rate = trainer.choose_steps(60 * minutes)
    log.info("%.1f steps a second: %d steps in %g minutes", rate, trainer.config.optimisation.steps, minutes)
    return trainer, 60 * minutes - trainer.step / rate


def _minutes(text: str) -> float:
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} must be above 0 minutes and finite")
    return value
