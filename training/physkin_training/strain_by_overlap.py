"""How strain goes with the overlap of the body itself: what is the garment's, and what the pose's.

`python -m physkin_training.strain_by_overlap [MODEL ...]` prints Markdown tables: held-out bodies, poses uniform in the
limits and every fourth frame of the bundled motions at 60 Hz; minutes a model. A pose's overlap is the share of the
skin under the garment, vertex by vertex, that another part of the body covers.

Dimensions: `P` poses, `d` degrees of freedom, `n` garment vertices.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar import avatar_from_body
from physkin_core.body_model import load_body_model
from physkin_core.draper import Draper
from physkin_core.garment_model import GarmentModel
from physkin_core.model_file import load_garment_model, shipped_models
from physkin_core.motion import bundled_motions, load_motion
from physkin_core.quality import area_strain, edge_strain
from physkin_training.body_overlap import Seats
from physkin_training.evaluation_pairs import uniform_pairs
from physkin_training.posed_bodies import BodySet, PosedBodies

__all__ = ["LIMITS", "OverlapRow", "main", "measure_strain_by_overlap"]

LIMITS = (0.5, 2.0, 5.0)
"""Overlaps [%] at which poses are parted."""
BODIES, POSES, BATCH = 16, 128, 16
MOTION_RATE, MOTION_STRIDE = 60.0, 4


@dataclass(frozen=True)
class OverlapRow:
    """Poses of one kind, "uniform" or "motion", whose overlap is above `least` and at most `most` [%].

    count: how many of `of` poses. edge_strain, area_strain: mean [%], NaN where there are none.
    """

    kind: str
    least: float
    most: float
    count: int
    of: int
    edge_strain: float
    area_strain: float


def measure_strain_by_overlap(
    model: GarmentModel, *, fit: float = 0.0, bodies: int = BODIES, poses: int = POSES
) -> list[OverlapRow]:
    """Drape one model and part its poses by overlap: of each kind all poses first, then those between `LIMITS`.

    bodies: the first of the held-out adults. poses: uniform ones a body, those of `physkin evaluate`. fit: 0 (template)
    to 1 (made to measure). Raises ValueError when the model has not learnt the fit, or there are not so many bodies.
    """
    body_model = load_body_model()
    if not 1 <= bodies <= len(body_model.held_out_bodies):
        raise ValueError(f"bodies must be 1 to {len(body_model.held_out_bodies)}, got {bodies}")
    seats = Seats(body_model.vertices(body_model.garment_body), body_model.faces, model.garment.vertices)
    figures: dict[str, list[np.ndarray]] = {"uniform": [], "motion": []}
    for body, coefficients in enumerate(body_model.held_out_bodies[:bodies]):
        draper = Draper(model, avatar_from_body(body_model, coefficients), fit=fit)
        worn = model.garment.reshaped(draper.bound.vertices)
        posed = PosedBodies(body_model, BodySet(body_model, coefficients[None], torch.device("cpu")), BATCH)
        for kind, positions, gravity in _takes(model, body, bodies=bodies, poses=poses):
            drapes = np.stack([draper.drape(q, g)[:, :3] for q, g in zip(positions, gravity)]).astype(np.float64)
            parts = _overlap(seats, posed, positions), edge_strain(worn, drapes), area_strain(worn, drapes)
            figures[kind].append(np.stack(parts))
    rows = []
    for kind, parts in figures.items():
        overlap, edge, area = np.concatenate(parts, axis=1)
        bounds = [(-np.inf, np.inf), *zip((-np.inf, *LIMITS), (*LIMITS, np.inf), strict=True)]
        for least, most in bounds:
            pick = (overlap > least) & (overlap <= most)
            means = (values[pick].mean() if pick.any() else np.nan for values in (edge, area))
            rows.append(OverlapRow(kind, least, most, int(pick.sum()), len(overlap), *means))
    return rows


def _takes(model: GarmentModel, body: int, *, bodies: int, poses: int) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Kind, joint positions (P, d) and gravity (P, 3), float32, of one of the bodies."""
    pairs = uniform_pairs(model.rig, bodies=bodies, poses=poses, seed=0, upright=True)
    own = pairs.body == body
    yield "uniform", pairs.positions[own].numpy(), pairs.gravity[own].numpy()
    for name in bundled_motions():
        motion = load_motion(name).resampled(MOTION_RATE)
        every = slice(None, None, MOTION_STRIDE)
        positions, gravity = motion.positions_for(model.rig)[every], motion.gravity[every]
        yield "motion", positions.astype(np.float32), gravity.astype(np.float32)


def _overlap(seats: Seats, posed: PosedBodies, positions: np.ndarray) -> np.ndarray:
    """Overlap [%] of one body in poses (P, d). Returns (P,)."""
    shares = []
    for start in range(0, len(positions), BATCH):
        rows = np.minimum(np.arange(start, start + BATCH), len(positions) - 1)
        posed.pose(torch.tensor(positions[rows]), torch.zeros(BATCH, dtype=torch.int64))
        shares.append(100 * seats.covered(posed)[: len(positions) - start].mean(axis=1))
    return np.concatenate(shares)


def main(argv: Sequence[str] | None = None) -> int:
    """Prints a table for each kind of pose. argv: default the command line's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", default=shipped_models(), help="garment model files or shipped names")
    parser.add_argument("--bodies", type=int, default=BODIES, help="held-out adults (default %(default)s)")
    parser.add_argument("--poses", type=int, default=POSES, help="uniform poses a body (default %(default)s)")
    options = parser.parse_args(argv)
    tables: dict[str, list[str]] = {"uniform": [], "motion": []}
    for path in options.models:
        model = load_garment_model(path)
        for fit in (0.0, 1.0) if model.made_to_measure else (0.0,):
            rows = measure_strain_by_overlap(model, fit=fit, bodies=options.bodies, poses=options.poses)
            for kind, lines in tables.items():
                cells = [
                    f"{row.edge_strain:.2f} / {row.area_strain:.2f} ({100 * row.count / row.of:.0f} %)"
                    for row in rows
                    if row.kind == kind
                ]
                name = "made to measure" if fit else f"**{Path(path).stem}**"
                lines.append("| " + " | ".join([name, *cells]) + " |")
    between = [f"{low:g} to {high:g} %" for low, high in zip(LIMITS, LIMITS[1:])]
    for kind, lines in tables.items():
        heads = [f"{kind}: edge / area %, all", f"overlap up to {LIMITS[0]:g} %", *between, f"above {LIMITS[-1]:g} %"]
        print("\n".join(["| " + " | ".join(["", *heads]) + " |", "|---" * (len(heads) + 1) + "|", *lines, ""]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
