"""How strain goes with the overlap of the body itself: what is the garment's, and what the pose's.

`PYTHONPATH=training python -m physkin_studies.strain_by_overlap [MODEL ...]` prints Markdown tables: held-out bodies,
poses uniform in the limits and every fourth frame of the bundled motions at 60 Hz; minutes a model. A pose's overlap is
the share of the skin under the garment, vertex by vertex, that another part of the body covers.

Dimensions: `P` poses, `d` degrees of freedom, `n` garment vertices.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from tabulate import tabulate

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, shipped_models
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.outfit.draper import Draper
from physkin_core.quality import area_strain, edge_strain
from physkin_training.evaluate.body_overlap import SkinPoints
from physkin_training.sampling.evaluation_pairs import uniform_pairs
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

__all__ = ["LIMITS", "OverlapRow", "main", "measure_strain_by_overlap"]

LIMITS = (0.5, 2.0, 5.0)
"""Overlaps [%] at which poses are parted."""
BODIES, POSES, BATCH = 16, 128, 16
"""The first of the held-out adults, uniform poses of each as in `physkin evaluate`, and poses at a time."""
FITS = (0.0, 1.0)
"""The template, and made to measure."""
MOTION_RATE, MOTION_STRIDE = 60.0, 4
KINDS = ("uniform", "motion")


@dataclass(frozen=True)
class OverlapRow:
    """Poses of one kind, "uniform" or "motion", whose overlap is above `least` and at most `most` [%], at one fit.

    count: how many of `of` poses. edge_strain, area_strain: mean [%], NaN where there are none.
    """

    fit: float
    kind: str
    least: float
    most: float
    count: int
    of: int
    edge_strain: float
    area_strain: float


def measure_strain_by_overlap(model: GarmentModel) -> list[OverlapRow]:
    """Drape one model and part its poses by overlap: of each fit and kind all poses, then those between `LIMITS`."""
    body_model = load_body_model()
    seats = SkinPoints.under(body_model.vertices(body_model.garment_body), body_model.faces, model.garment.vertices)
    uniform = uniform_pairs(model.rig, bodies=BODIES, poses=POSES, seed=0, upright=True)
    clips = [load_motion(name).resampled(MOTION_RATE) for name in bundled_motions()]
    every = slice(None, None, MOTION_STRIDE)
    motion = [(clip.positions_for(model.rig)[every].astype(np.float32), clip.gravity[every]) for clip in clips]
    figures: dict[tuple[float, str], list[np.ndarray]] = {(fit, kind): [] for fit in FITS for kind in KINDS}
    for body, coefficients in enumerate(body_model.held_out_bodies[:BODIES]):
        own = uniform.body == body
        takes = {"uniform": [(uniform.positions[own].numpy(), uniform.gravity[own].numpy())], "motion": motion}
        posed = PosedBodies(body_model, BodySet(body_model, coefficients[None], torch.device("cpu")), BATCH)
        overlaps = {kind: [_overlap(seats, posed, positions) for positions, _ in take] for kind, take in takes.items()}
        avatar = avatar_from_body(body_model, coefficients)
        for fit in FITS:
            draper = Draper(model, avatar, fit=fit)
            for kind, take in takes.items():
                for part, overlap in zip(take, overlaps[kind], strict=True):
                    drapes = np.stack(draper.layer.drape(zip(*part)))[:, :, :3].astype(np.float64)
                    figures[fit, kind].append(
                        np.stack(
                            [
                                overlap,
                                edge_strain(draper.rest_garment, drapes),
                                area_strain(draper.rest_garment, drapes),
                            ]
                        )
                    )
    rows = []
    for (fit, kind), parts in figures.items():
        overlap, edge, area = np.concatenate(parts, axis=1)
        bounds = [(-np.inf, np.inf), *zip((-np.inf, *LIMITS), (*LIMITS, np.inf), strict=True)]
        for least, most in bounds:
            pick = (overlap > least) & (overlap <= most)
            means = (values[pick].mean() if pick.any() else np.nan for values in (edge, area))
            rows.append(OverlapRow(fit, kind, least, most, int(pick.sum()), len(overlap), *means))
    return rows


def _overlap(seats: SkinPoints, posed: PosedBodies, positions: np.ndarray) -> np.ndarray:
    """Overlap [%] of one body in poses (P, d). Returns (P,)."""
    overlapped = [seats.overlapped(posed)[: rows.stop - rows.start] for rows in posed.pose_in_turn(positions)]
    return 100 * torch.cat(overlapped).numpy().mean(axis=1)


def main(argv: Sequence[str] | None = None) -> int:
    """Prints a table for each kind of pose. argv: default the command line's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", default=shipped_models(), help="garment model files or shipped names")
    options = parser.parse_args(argv)
    tables: dict[str, list[list[str]]] = {kind: [] for kind in KINDS}
    for path in options.models:
        model = load_garment_model(path)
        rows = measure_strain_by_overlap(model)
        for fit in FITS:
            for kind, lines in tables.items():
                cells = [
                    f"{row.edge_strain:.2f} / {row.area_strain:.2f} ({100 * row.count / row.of:.0f} %)"
                    for row in rows
                    if (row.fit, row.kind) == (fit, kind)
                ]
                name = "made to measure" if fit else f"**{Path(path).stem}**"
                lines.append([name, *cells])
    between = [f"{low:g} to {high:g} %" for low, high in zip(LIMITS, LIMITS[1:])]
    for kind, lines in tables.items():
        heads = [f"{kind}: edge / area %, all", f"overlap up to {LIMITS[0]:g} %", *between, f"above {LIMITS[-1]:g} %"]
        print(tabulate(lines, ["", *heads], tablefmt="github") + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
