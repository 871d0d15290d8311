"""What a training run says of itself: losses.jsonl, TensorBoard scalars, and a line of progress or lines of log."""

from __future__ import annotations

import json
import logging
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from physkin_core.progress import progress_line
from physkin_training.train.trainer import TERMS, Trainer

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

__all__ = ["RunReports", "scalar_writer"]

log = logging.getLogger(__name__)
LINE_EVERY = 10
"""Reports between two lines of log."""


def scalar_writer(folder: Path) -> SummaryWriter:
    """What writes figures for TensorBoard, without TensorFlow: where that is installed, loading it would take seconds
    and print lines of its own."""
    sys.modules.setdefault("tensorboard.compat.notf", ModuleType("notf"))  # how TensorBoard is told to use its stub
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(folder)


class RunReports:
    """Reports of one run into `output`, appended to those that are there. Use as a context."""

    def __init__(self, trainer: Trainer, output: Path, *, every: int) -> None:
        self._trainer, self._output, self._every = trainer, output, every
        self._started, self._first_step = time.perf_counter(), trainer.step

    def __enter__(self) -> RunReports:
        self._writer = scalar_writer(self._output / "scalars")
        self._record = open(self._output / "losses.jsonl", "a")
        self._progress = progress_line("training")
        return self

    def __exit__(self, *_) -> None:
        self._record.close()
        self._writer.close()

    @property
    def seconds(self) -> float:
        """Time [s] since the run began or went on."""
        return time.perf_counter() - self._started

    def report(self) -> None:
        """The figures of the steps since the last report. Raises TrainingDiverged when they are not finite."""
        trainer = self._trainer
        energies = trainer.mean_energies()
        row = {"step": trainer.step, "seconds": self.seconds, "range": trainer.range.item()} | energies
        row["median_stretch_and_collision"] = trainer.median_energy()
        row["gradient_norm"] = trainer.gradient_norm.item()
        if trainer.validation_energy is not None:
            row["validation_energy"] = trainer.validation_energy
            row["validation_energy_made_to_measure"] = trainer.validation.made_to_measure
            row["validation_strained"] = trainer.validation.strained
        if trainer.best:
            row |= {"best_validation_energy": trainer.best.energy, "best_step": trainer.best.step}
        step = row["step"]
        self._record.write(json.dumps(row) + "\n")
        self._record.flush()
        for name, value in row.items():
            self._writer.add_scalar(name, value, step)
        left = trainer.config.optimisation.steps - self._first_step
        self._progress((step - self._first_step) / left)
        if not sys.stderr.isatty() and step // self._every % LINE_EVERY == 0:
            self._log(row)

    def _log(self, row: dict) -> None:
        optimisation = self._trainer.config.optimisation
        terms = "  ".join(f"{term} {row[term]:.4f}" for term in TERMS)
        done = row["step"] - self._first_step - self._trainer.skipped
        rate = done * optimisation.samples / row["seconds"]
        left = (optimisation.steps - row["step"]) * row["seconds"] / done / 60
        log.info(
            "step %d/%d  %s  median %.4f  range %.1f  %.0f samples/s  %.1f minutes left",
            *(row["step"], optimisation.steps, terms, row["median_stretch_and_collision"], row["range"], rate, left),
        )
        if "best_step" in row:
            log.info(
                "validation %.4f J  best %.4f J of step %d",
                *(row.get("validation_energy", float("nan")), row["best_validation_energy"], row["best_step"]),
            )
