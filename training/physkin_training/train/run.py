"""A training run from its first step to the model file: reports, checkpoints, models on the way, export."""

from __future__ import annotations

import logging
import math
import signal
import time
from dataclasses import replace
from pathlib import Path

from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.hyper_modulator import BENDING_OCTAVES
from physkin_core.model.model_file import save_garment_model
from physkin_training.networks.export import ExportError, model_from_drape, store_checked
from physkin_training.networks.rest_normals import fitted_rest_normals
from physkin_training.rounding.rounded_model import rounded_model
from physkin_training.train.checkpoint import CHECKPOINT_SUFFIX
from physkin_training.train.run_reports import RunReports
from physkin_training.train.trainer import Trainer, TrainingDiverged
from physkin_training.transfer.sway_transfer import transferred_sway

__all__ = ["CHECKPOINT", "CHECKPOINT_EVERY", "best_model", "export", "trained_model"]

log = logging.getLogger(__name__)
CHECKPOINT = f"checkpoint{CHECKPOINT_SUFFIX}"
"""In the run's folder."""
CHECKPOINT_EVERY = 300.0
"""[s] From one checkpoint to the next, by default."""
REPORTS, MOST_STEPS, LEAST_STEPS = 200, 200, {"cuda": 10, "cpu": 1}
"""Reports of a run, about; steps from one to the next, at most and at least."""
SHOWN_EVERY = 30.0
"""[s] At least, from one model that is written on the way to the next."""


def trained_model(
    trainer: Trainer,
    folder: Path,
    output: Path,
    *,
    within: float = math.inf,
    checkpoint_every: float = CHECKPOINT_EVERY,
    shown: bool = False,
) -> GarmentModel:
    """Take the trainer's steps to the end of its run, and write its model as `output`.

    Args:
        trainer: at its first step, or resumed.
        folder: gets the checkpoint, `losses.jsonl` and scalars for TensorBoard.
        output: model file.
        within: [s] where the steps would take longer, some are left out on the way.
        checkpoint_every: [s].
        shown: whether the best model so far is written as `output` now and then, and at the end before it is rounded.

    Returns:
        The model, as read from the file.

    Raises:
        KeyboardInterrupt: for Ctrl-C, after a checkpoint; for a second one, at once.
        TrainingDiverged: where energies are not finite; it says whether there is a checkpoint from before.
        ExportError: where the model drapes otherwise than the networks it was made of.
    """
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / CHECKPOINT
    try:
        interrupted = _take_steps(trainer, folder, within, checkpoint_every, output if shown else None)
        trainer.save(checkpoint)
    except TrainingDiverged as error:
        kept = f"; {checkpoint} is from before, start from it with a lower learning rate" if checkpoint.exists() else ""
        raise TrainingDiverged(f"{error}{kept}") from error
    if interrupted:
        log.info("stopped at step %d, which --resume goes on from: %s", trainer.step, checkpoint)
        raise KeyboardInterrupt
    model = export(trainer, output, shown=shown)
    log.info("%s: %.2f MB", output, output.stat().st_size / 1e6)
    return model


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


def _take_steps(trainer: Trainer, folder: Path, within: float, checkpoint_every: float, shown: Path | None) -> bool:
    """Run to the end, or until Ctrl-C: whether that was it."""
    steps = trainer.config.optimisation.steps
    every = max(LEAST_STEPS[trainer.device.type], min(MOST_STEPS, steps // REPORTS))
    saved = written = time.perf_counter()
    best = trainer.best
    with RunReports(trainer, folder, every=every) as reports, _Interrupt() as interrupt:
        for step in trainer.run(steps):
            if interrupt.requested:
                return True
            if time.perf_counter() - saved > checkpoint_every:
                trainer.save(folder / CHECKPOINT)
                saved = time.perf_counter()
            better = trainer.best is not best and trainer.best.step > 0  # at 0 it is what is shown already
            if shown and better and time.perf_counter() - written > SHOWN_EVERY:
                save_garment_model(best_model(trainer), shown)
                best, written = trainer.best, time.perf_counter()
            if step % every == 0 or step == steps or trainer.settled:
                reports.report()
                if step < steps and not trainer.settled:
                    on_time = int(steps * reports.seconds / within)
                    trainer.skip_to(max(step, min(on_time, steps - 1)))
    if trainer.settled:
        waited = trainer.config.optimisation.patience
        log.info(
            "%d measurements found no lower energy than that of step %d: training ends here", waited, trainer.best.step
        )
    return False


def export(trainer: Trainer, path: Path, *, shown: bool = False) -> GarmentModel:
    """Write the model of the run's best drape, and return it. shown: whether it is written at once, not rounded. Raises
    ExportError, and writes nothing else as `path`, when it drapes otherwise, rounded as finely as can be."""
    drape = trainer.best_drape()
    if best := trainer.best:
        log.info("the model is the one of step %d, with the lowest validation energy, %.4f J", best.step, best.energy)
    model = best_model(trainer)
    if shown:
        save_garment_model(model, path)
        log.info("wrote %s as it was trained; now it is rounded, compared and measured", path)
    model = replace(model, rest_normals=fitted_rest_normals(drape, trainer.garment, trainer.rig))
    try:
        return store_checked(rounded_model(model, device=trainer.device), drape, path)
    except ExportError as error:
        log.info("%s: rounded more finely", error)
    return store_checked(rounded_model(model, device=trainer.device, finely=True), drape, path)


def best_model(trainer: Trainer) -> GarmentModel:
    """Of the run's best drape, with the mesh's normals, network weights as they are, and the sway of what it began
    with."""
    config, best, start = trainer.config, trainer.best, trainer.start
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
    if start and start.sway is not None:
        model = replace(model, sway=transferred_sway(start, model, trainer.body_model, trainer.device))
    return model
