"""`physkin train`: learn a garment from its mesh and physics, with checkpoints, TensorBoard scalars and export."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from pathlib import Path

from physkin_core.model_file import load_garment_model, save_garment_model
from physkin_training.checkpoint import CheckpointError
from physkin_training.config import ConfigError, load_config
from physkin_training.devices import DEFAULT_DEVICE, resolve_device
from physkin_training.export import agreement, model_from_drape, plain_training_data
from physkin_training.trainer import Trainer

__all__ = ["main"]

log = logging.getLogger(__name__)
AGREEMENT = 1e-3
"""Largest distance [m] allowed between the exported model's drape at run time and in torch."""


def main(argv: list[str] | None = None) -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(prog="physkin train", description=__doc__)
    parser.add_argument("--config", type=Path, required=True, help="training configuration (TOML)")
    parser.add_argument("--output", type=Path, required=True, help="folder for checkpoint, scalars and the model")
    parser.add_argument("--resume", type=Path, metavar="FOLDER", help="go on from this checkpoint")
    parser.add_argument("--start-from", type=Path, metavar="FOLDER", help="new run from this checkpoint's networks")
    parser.add_argument("--device", default=DEFAULT_DEVICE)
    parser.add_argument(
        "--stop-after", type=float, default=0, metavar="MINUTES", help="then write a checkpoint and stop"
    )
    parser.add_argument("--log-every", type=int, default=200, metavar="STEPS")
    arguments = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        config = load_config(arguments.config)
        trainer = Trainer(config, resolve_device(arguments.device))
        if arguments.resume:
            trainer.resume(arguments.resume)
        elif arguments.start_from:
            trainer.start_from(arguments.start_from)
    except (ConfigError, CheckpointError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    arguments.output.mkdir(parents=True, exist_ok=True)
    finished = _train(trainer, arguments)
    trainer.save(arguments.output / "checkpoint")
    if not finished:
        log.info("stopped at step %d; go on with --resume %s", trainer.step, arguments.output / "checkpoint")
        return 0
    path = arguments.output / f"{config.name}.safetensors"
    model = model_from_drape(
        trainer.drape,
        trainer.garment,
        trainer.rig,
        name=config.name,
        influences=config.garment_nodes.influences,
        material=config.material,
        training=plain_training_data(config),
    )
    save_garment_model(model, path)
    difference = agreement(load_garment_model(path))
    if difference > AGREEMENT:
        print(f"error: exported model drapes {difference * 1000:.2f} mm away from torch", file=sys.stderr)
        return 1
    size = path.stat().st_size / 1e6
    log.info("%s: %.2f MB, run time and torch agree to %.4f mm", path, size, difference * 1000)
    return 0


def _train(trainer: Trainer, arguments: argparse.Namespace) -> bool:
    """Run to the end or until the time is up; returns whether the run is finished."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from torch.utils.tensorboard import SummaryWriter

    steps = trainer.config.optimisation.steps
    started, first_step = time.perf_counter(), trainer.step
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with (
        SummaryWriter(arguments.output / "scalars") as writer,
        open(arguments.output / "losses.jsonl", "a") as record,
        Progress(*columns, disable=not sys.stderr.isatty()) as progress,
    ):
        task = progress.add_task("training", total=steps, completed=trainer.step)
        for step in trainer.run(steps):
            if step % arguments.log_every and step != steps:
                continue
            energies = trainer.mean_energies()
            seconds = time.perf_counter() - started
            row = {"step": step, "seconds": seconds, "range": trainer.range.item()} | energies
            row["gradient_norm"] = trainer.gradient_norm.item()
            record.write(json.dumps(row) + "\n")
            record.flush()
            for name, value in row.items():
                writer.add_scalar(name, value, step)
            total = sum(energies.values())
            progress.update(task, completed=step, description=f"energy {total:8.4f} J")
            if not sys.stderr.isatty() and step // arguments.log_every % 10 == 0:
                rate = (step - first_step) * trainer.config.optimisation.samples / seconds
                terms = "  ".join(f"{name} {value:.4f}" for name, value in energies.items())
                log.info("step %d/%d  %s  range %.1f  %.0f samples/s", step, steps, terms, row["range"], rate)
            if arguments.stop_after and seconds > 60 * arguments.stop_after:
                return step >= steps
    return True


if __name__ == "__main__":
    raise SystemExit(main())
