"""The report on finished ablations: frame times of this CPU, tables, plots and pictures.

Dimensions: `n` garment vertices, `V` body vertices.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from tabulate import tabulate

from physkin_bench.cases import model_case
from physkin_core.bench import STAGES, bound_frame, time_in_turns
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.loading import load_motion
from physkin_core.pictures.picture import CLOTH_COLOUR, Mesh, PictureError, contact_sheet, render, save_png
from physkin_core.runtime.evaluator import Evaluator
from physkin_studies.ablation_rows import BASE, ROWS, finished_figures, model_path
from physkin_studies.fantastical_bodies import KINDS, fantastical_body_model
from physkin_training.evaluate.contact_sheet import drape_all
from physkin_training.evaluate.evaluate import Evaluation
from physkin_training.sampling.evaluation_pairs import Pairs, motion_pairs

__all__ = ["frame_times", "write_report"]

CPU = torch.device("cpu")
ROUNDS, TIMED = 60, ("frame", "networks", "skinning")
PAPER = {
    "nodes32-fixed": "7.010 / 8.091 / 0.316",
    "nodes64-fixed": "5.817 / 6.103 / 0.207",
    "nodes128-fixed": "4.266 / 4.093 / 0.129",
    "nodes64": "4.512 / 4.718 / 0.126",
    "nodes128": "3.074 / 3.193 / 0.119",
    "nodes256": "3.068 / 3.188 / 0.117",
}
NODE_ROWS = (*PAPER, "detail", "seed1", "seed2")
NETWORK_ROWS = (BASE, "supervised")
FIGURES = {
    "edge %": ("edge_strain_percent", "{:.2f}"),
    "area %": ("area_strain_percent", "{:.2f}"),
    "inside %": ("inside_percent", "{:.3f}"),
    "< 3 mm %": ("within_3mm_percent", "{:.2f}"),
    "depth p99.9 mm": ("max_depth_p999_mm", "{:.0f}"),
    "energy J": ("energy_j", "{:.3f}"),
}
PICTURE_SIZE = (230, 300)


def write_report(folder: Path) -> Path:
    """Write `report/ablations.md` with its plots and pictures from the rows finished in `folder`; returns its path.

    Raises ValueError when no row is finished.
    """
    rows = {name: figures for name in ROWS if (figures := finished_figures(folder, name))}
    if not rows:
        raise ValueError(f"no finished row in {folder}: nothing to report on")
    report = folder / "report"
    report.mkdir(exist_ok=True)
    times = frame_times({name: model_path(folder, name) for name in rows})
    first = next(iter(rows.values()))
    counts = first["figures"]["model"]["pairs"]
    parts = [
        "# Ablations",
        f"Each row trained for {first['budget_minutes']:g} minutes on one {first['device']}, the reference material. "
        f"Figures on {counts} pairs of held-out adults and uniform poses over the full range, in one size, roots "
        "upright; frame and skinning times with the native evaluator on one core of the machine that wrote this "
        "(median, fp32).",
        "## Garment nodes and skinning weights",
        _node_table(rows, times),
        "The paper's figures are of its own bodies, motion and material; see docs/training.md. Rows with "
        "another seed are the base again: differences within theirs mean nothing.",
        "## Supervision",
        _network_table(rows, times),
    ]
    parts += ["![Energy over training](ablations_curves.svg)", "![Figures](ablations_figures.svg)"]
    _plot(report, rows)
    fantastical = {name: row["fantastical"] for name, row in rows.items() if "fantastical" in row}
    if fantastical:
        parts += ["## Fantastical bodies", _fantastical_table(fantastical)]
        try:
            models = {ROWS[name].label: load_garment_model(model_path(folder, name)) for name in fantastical}
            save_png(report / "ablations_fantastical.png", _fantastical_sheet(models))
            parts.append("![Fantastical bodies](ablations_fantastical.png)")
        except PictureError as error:
            parts.append(f"No pictures: {error}")
    path = report / "ablations.md"
    path.write_text("\n\n".join(part for part in parts if part) + "\n")
    (report / "times.json").write_text(json.dumps(times, indent=1))
    return path


def frame_times(models: Mapping[str, Path]) -> dict[str, dict[str, float]]:
    """Median microseconds of a `frame`, its `networks` and its `skinning` on one core of this machine, in turns."""
    calls = {}
    for name, path in models.items():
        case = model_case(path)
        middle = len(case.joint_positions) // 2
        evaluator = Evaluator([case.bound], precision="fp32")
        frame = bound_frame(evaluator, case.bound, case.joint_positions[middle], case.inputs[middle].copy())
        calls |= {(name, stage): getattr(frame, STAGES[stage]) for stage in TIMED}
    timings = time_in_turns(calls, rounds=ROUNDS)
    return {name: {stage: timings[name, stage].p50 for stage in TIMED} for name in models}


def _table(header: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    return tabulate(rows, list(header), tablefmt="github", disable_numparse=True) if rows else ""


def _cells(figures: Mapping[str, float]) -> list[str]:
    return [text.format(figures[key]) for key, text in FIGURES.values()]


def _node_table(rows: Mapping[str, dict], times: Mapping[str, dict]) -> str:
    header = ["nodes", "skinning weights", *FIGURES, "skinning µs", "frame µs", "steps", "paper edge / area / inside %"]
    lines = []
    for name in NODE_ROWS:
        if name in rows:
            config = rows[name]["config"]
            trained = "trained" if config["optimisation"]["skinning_rate"] > 0 else "fixed"
            if detail := config["detail"]["nodes"]:
                trained += f", {detail} detail nodes beside them"
            elif name not in PAPER:
                trained += f", seed {config['seed']}"
            spent = [f"{times[name][key]:.1f}" for key in ("skinning", "frame")]
            cells = [config["garment_nodes"]["count"], trained, *_cells(rows[name]["figures"]["model"])]
            lines.append([*cells, *spent, rows[name]["steps"], PAPER.get(name, "-")])
    return _table(header, lines)


def _network_table(rows: Mapping[str, dict], times: Mapping[str, dict]) -> str:
    header = ["", *FIGURES, "networks µs", "frame µs", "steps", "training s"]
    lines = []
    for name in NETWORK_ROWS:
        if name in rows:
            label = "base: self-supervised" if name == BASE else ROWS[name].label
            timed = [f"{times[name][key]:.1f}" for key in ("networks", "frame")]
            spent = [rows[name]["steps"], f"{rows[name]['seconds']:.0f}"]
            lines.append([label, *_cells(rows[name]["figures"]["model"]), *timed, *spent])
    if BASE in rows:
        dashes = ["-"] * 4
        lines.append(["plain skinning, with the base's weights", *_cells(rows[BASE]["figures"]["skinning"]), *dashes])
    return _table(header, lines)


def _fantastical_table(fantastical: Mapping[str, dict]) -> str:
    lines = []
    for kind in KINDS:
        for name, kinds in fantastical.items():
            trained = "fantastical bodies" if name == "fantastical" else "adults"
            lines.append([kind, trained, *_cells(kinds[kind]["model"])])
        lines.append([kind, "plain skinning", *_cells(next(iter(fantastical.values()))[kind]["skinning"])])
    return _table(["bodies", "trained on", *FIGURES], lines)


def _plot(report: Path, rows: Mapping[str, dict]) -> None:
    figure = Figure(figsize=(9, 4.5), layout="tight")
    axes = figure.subplots()
    for row in rows.values():
        points = [(point["seconds"] / 60, point["energy_j"]) for point in row["curve"]]
        axes.semilogy(*zip(*points), label=row["label"])
    axes.set(title="Averaged model, fixed bodies and poses", xlabel="minutes", ylabel="energy [J] but for gravity")
    _save(figure, report / "ablations_curves.svg")
    figure = Figure(figsize=(9, 3.5), layout="tight")
    axes = figure.subplots()
    scaled = {"edge %": ("edge_strain_percent", 1), "area %": ("area_strain_percent", 1)}
    scaled["inside, 0.1 %"] = ("inside_percent", 10)
    for index, (label, (key, factor)) in enumerate(scaled.items()):
        heights = [factor * row["figures"]["model"][key] for row in rows.values()]
        axes.bar(np.arange(len(rows)) + 0.27 * (index - 1), heights, 0.25, label=label)
    axes.set_xticks(range(len(rows)), [row["label"] for row in rows.values()], rotation=25, ha="right")
    axes.set(title="Held-out adults, uniform poses")
    _save(figure, report / "ablations_figures.svg")


def _save(figure: Figure, path: Path) -> None:
    figure.axes[0].legend(loc="upper left", bbox_to_anchor=(1, 1))
    figure.savefig(path)


def _fantastical_sheet(models: Mapping[str, GarmentModel]) -> np.ndarray:
    """Each kind's first held-out body, at the canonical pose and in a walk, in the garment of every model."""
    body_model = fantastical_body_model()
    rig = next(iter(models.values())).rig
    walk = motion_pairs(load_motion("walk"), rig, bodies=1)
    middle = len(walk) // 3
    rest = torch.as_tensor(rig.rest.copy(), dtype=torch.float32)
    positions = torch.stack([rest, walk.positions[middle]])
    gravity = torch.stack([torch.tensor([0.0, 0.0, -1.0]), walk.gravity[middle]])
    poses = Pairs(positions, gravity, torch.zeros(2, dtype=torch.int64))
    pictures, captions = [], []
    for label, model in models.items():
        bodies = list(range(len(KINDS)))
        evaluation = Evaluation(model, CPU, bodies=bodies, poses=len(poses), seed=0, fit=0.0, body_model=body_model)
        drapes = drape_all(evaluation, poses, minimum=False)
        for pair, cloth in enumerate(drapes.garments["model"]):
            meshes = [Mesh(drapes.bodies[pair], body_model.faces), Mesh(cloth, model.garment.faces, CLOTH_COLOUR)]
            pictures.append(render(meshes, size=PICTURE_SIZE, samples=8))
            captions.append(f"{list(KINDS)[pair % len(KINDS)]}, {label}")
    return contact_sheet(pictures, columns=2 * len(KINDS), captions=captions, gap=4)
