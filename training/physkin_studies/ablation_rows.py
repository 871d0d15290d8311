"""The rows of the ablations: each is one change of a base configuration, trained for a time and measured.

Runs where there is a GPU and nothing but torch, Warp, numpy, scipy, safetensors, trimesh, potpourri3d and pydantic. A
row leaves a model file and `figures.json`, which is written last: a row that has it is finished.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_studies.fantastical_bodies import KINDS, fantastical_body_model
from physkin_studies.supervised import SupervisedTrainer, simulate_drapes
from physkin_training.config import DetailConfig, TrainingConfig, load_config
from physkin_training.devices import resolve_device
from physkin_training.evaluate.evaluate import Evaluation
from physkin_training.networks.export import ExportError
from physkin_training.train.train import export
from physkin_training.train.trainer import Trainer, TrainingDiverged

__all__ = ["BASE", "ROWS", "Row", "finished_figures", "model_path", "run_row"]

log = logging.getLogger(__name__)
BASE = "nodes128"
"""The row that all others are compared with."""
TRAINING = Path(__file__).parents[1]
RECIPE, GARMENT = TRAINING / "configs" / "wardrobe.toml", TRAINING / "garments" / "tshirt.obj"
"""What rows change: all but one leave the recipe's detail out, as the paper has none."""
BODIES, POSES = 16, 64
"""Held-out bodies, and uniform poses of each, to measure on."""
DRAPES, DRAPE_BATCH = 1000, 128
"""How many drapes are simulated for the supervised row, and how many at once."""
CURVE_POINTS, CURVE_SHARE = 24, 0.02
"""Points of a row's curve, and the share of its time that measuring them may take."""


@dataclass(frozen=True)
class Row:
    """label: in tables and plots. change: what makes its configuration of the base's. supervised: learns simulated
    drapes. on_fantastical: measured on fantastical bodies too. bodies: whom it is trained on."""

    label: str
    change: Callable[[TrainingConfig], TrainingConfig]
    supervised: bool = False
    on_fantastical: bool = False
    bodies: Callable[[], BodyModel] = load_body_model


def _nodes(count: int, *, optimised: bool) -> Callable[[TrainingConfig], TrainingConfig]:
    def change(config: TrainingConfig) -> TrainingConfig:
        optimisation = config.optimisation if optimised else replace(config.optimisation, skinning_rate=0.0)
        nodes = replace(config.garment_nodes, count=count)
        return replace(config, garment_nodes=nodes, detail=DetailConfig(nodes=0), optimisation=optimisation)

    return change


def _with_detail(config: TrainingConfig) -> TrainingConfig:
    return replace(config, detail=DetailConfig(nodes=1024))


def _fantastical(config: TrainingConfig) -> TrainingConfig:
    most = len(fantastical_body_model().train_bodies)
    return replace(config, train_bodies=min(config.train_bodies, most))


ROWS = {
    "nodes32-fixed": Row("32 nodes, fixed", _nodes(32, optimised=False)),
    "nodes64-fixed": Row("64 nodes, fixed", _nodes(64, optimised=False)),
    "nodes128-fixed": Row("128 nodes, fixed", _nodes(128, optimised=False)),
    "nodes64": Row("64 nodes", _nodes(64, optimised=True)),
    BASE: Row("128 nodes", _nodes(128, optimised=True), on_fantastical=True),
    "nodes256": Row("256 nodes", _nodes(256, optimised=True)),
    "detail": Row("128 nodes and 1,024 detail nodes", _with_detail),
    "supervised": Row("supervised", lambda config: config, supervised=True),
    "fantastical": Row("fantastical", _fantastical, on_fantastical=True, bodies=fantastical_body_model),
    "seed1": Row("128 nodes, seed 1", lambda config: replace(config, seed=1)),
    "seed2": Row("128 nodes, seed 2", lambda config: replace(config, seed=2)),
}


def model_path(folder: Path, name: str) -> Path:
    """Where a row's model file lies in the ablations' folder."""
    return folder / name / f"{name}.safetensors"


def finished_figures(folder: Path, name: str) -> dict | None:
    """What a finished row left in the ablations' folder, None while it is not finished."""
    path = folder / name / "figures.json"
    return json.loads(path.read_text()) if path.exists() else None


def run_row(name: str, base: TrainingConfig, folder: Path, device: torch.device, minutes: float) -> dict:
    """Train and measure one row into `folder`/`name`. Returns its figures.

    Raises ValueError for impossible configurations, TrainingDiverged when training does.
    """
    row, own = ROWS[name], folder / name
    config = replace(row.change(ROWS[BASE].change(base)), name=name)
    own.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(config, device, body_model=row.bodies())
    device_name = torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"
    result: dict = {"row": name, "label": row.label, "budget_minutes": minutes, "device": device_name}
    simulated = own / "drapes"
    if row.supervised:
        began = time.perf_counter()
        drapes = simulate_drapes(trainer, DRAPES, simulated, batch=DRAPE_BATCH)
        trainer = SupervisedTrainer(config, device, drapes)
        result["simulated"] = {
            "drapes": drapes.converged.numel(),
            "converged_percent": 100 * drapes.converged.float().mean().item(),
            "mean_gradient_norm_n": drapes.gradient_norm.mean().item(),
            "seconds": time.perf_counter() - began,
        }
    result |= _train(trainer, minutes)
    model = export(trainer, model_path(folder, name))
    result["config"] = trainer.config.as_plain_data()
    result["figures"] = _measured(model, device, range(BODIES), None)
    if row.on_fantastical:
        result["fantastical"] = _on_fantastical(model, device)
    partial = own / "figures.partial"
    partial.write_text(json.dumps(result, indent=1))
    partial.replace(own / "figures.json")
    shutil.rmtree(simulated, ignore_errors=True)
    return result


def _train(trainer: Trainer, minutes: float) -> dict:
    """Train for a time; the curve is the energy of the averaged drape on a fixed set over the full range of poses."""
    began = time.perf_counter()
    rate = trainer.choose_steps(60 * minutes)
    steps = trainer.config.optimisation.steps
    log.info("%.1f steps a second: %d steps in %g minutes", rate, steps, minutes)
    measuring = time.perf_counter()
    curve = [{"step": 0, "seconds": 0.0, "energy_j": trainer.average_energy()}]
    first = time.perf_counter()
    points = min(CURVE_POINTS, CURVE_SHARE * 60 * minutes / (first - measuring))
    every = math.ceil(steps / max(1, int(points)))
    for step in trainer.run(steps):
        if step % every == 0 or step == steps:
            energy = trainer.average_energy()
            curve.append({"step": step, "seconds": time.perf_counter() - first, "energy_j": energy})
            log.info("step %d of %d, %.0f s, %.4f J", step, steps, curve[-1]["seconds"], energy)
    trainer.close()
    return {
        "steps": steps,
        "steps_a_second": rate,
        "seconds": time.perf_counter() - began,
        "exported_step": trainer.best.step if trainer.best else steps,
        "curve": curve,
    }


def _measured(model: GarmentModel, device: torch.device, bodies: range, body_model: BodyModel | None) -> dict:
    """Figures in one size, the paper's: of the template."""
    given = {"poses": POSES, "seed": 0, "batch": 64 if device.type == "cuda" else 16, "body_model": body_model}
    evaluation = Evaluation(model, device, bodies=list(bodies), fit=0.0, **given)
    return evaluation.figures(upright=True, only=("model", "skinning"))


def _on_fantastical(model: GarmentModel, device: torch.device) -> dict:
    body_model = fantastical_body_model()
    count = len(body_model.held_out_bodies)
    kinds = {kind: range(index, count, len(KINDS)) for index, kind in enumerate(KINDS)}
    return {kind: _measured(model, device, bodies, body_model) for kind, bodies in kinds.items()}


def main(argv: list[str] | None = None) -> int:
    """Command line of one row, started by `physkin_studies.ablations`."""
    parser = argparse.ArgumentParser(prog="python -m physkin_studies.ablation_rows", description=main.__doc__)
    parser.add_argument("row", choices=tuple(ROWS))
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--device", required=True)
    parser.add_argument("--minutes", type=float, required=True)
    arguments = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        device = resolve_device(arguments.device)
        base = load_config(RECIPE, name=BASE, garment=GARMENT)
        run_row(arguments.row, base, arguments.output, device, arguments.minutes)
    except (ValueError, TrainingDiverged, ExportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
