"""Figures of cloth in motion: drapes with sway, and without, against references of simulated cloth.

`at_rest_mm` is what a model's drape without sway is away from the simulation before anything moves;
`moving_rmse_mm` is the distance less that of the first frame, vertex by vertex.

Dimensions: `T` frames, `k` points below the hips, `n` garment vertices. Metres, root frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.motion.motion import Motion
from physkin_core.outfit.draper import Draper
from physkin_core.quality import edge_strain
from physkin_core.sway.frame_input import FrameInput
from physkin_training.dynamics.fold_curvature import NEIGHBOURS, FoldCurvature
from physkin_training.dynamics.frame_potential import frame_potentials
from physkin_training.dynamics.reference import Reference, load_reference
from physkin_training.dynamics.scenes import ACTED_SCENES, ROOT_SCENES, scene_wind
from physkin_training.dynamics.swing_figures import hem_velocity, octaves, settling, swing, turning
from physkin_training.energies.motion import Dynamics

__all__ = ["evaluate_dynamics", "played", "references_of"]

RATES = (15.0, 30.0, 60.0, 120.0)
LOST = 0.2
"""Share of messages lost."""
POTENTIAL_EVERY = 24
STANDING = 3.0
"""Seconds of standing after the stop, at whose end cloth should hang still."""
STREAMS = 5


@dataclass(frozen=True)
class Played:
    """One reference on one body: points (T, k, 3) of the simulation and of drapes without and with sway."""

    reference: Reference
    body: int
    draper: Draper
    simulated: np.ndarray
    quasi_static: np.ndarray
    swaying: np.ndarray
    strains: tuple[float, float]


def references_of(garment: str, folder: Path) -> list[Reference]:
    """All references of a garment in a folder. Raises ValueError where there are none."""
    paths = sorted(folder.glob(f"{garment}_*.npz"))
    if not paths:
        raise ValueError(f"no references of {garment!r} in {folder}; physkin simulate {garment} --dynamic makes them")
    return [load_reference(path) for path in paths]


def played(draper: Draper, motion: Motion, *, kept: Sequence[int] | None = None) -> np.ndarray:
    """Whole drapes (T, n, 3) float32 with sway, of all frames or those `kept`, from hanging still."""
    positions, roots, wind = motion.positions_for(draper.model.rig), motion_roots(motion), scene_wind(motion)
    draper.reset()
    drapes = []
    for k in range(motion.frame_count) if kept is None else kept:
        draper.wind = wind[k]
        drapes.append(draper.drape(positions[k], time=k / motion.rate_hz, root=roots[k])[:, :3])
    draper.wind = np.zeros(3)
    return np.stack(drapes)


def _still(draper: Draper, motion: Motion) -> np.ndarray:
    """Whole drapes (T, n, 3) float32 without sway, of all frames."""
    turn = Rotation.from_quat(motion.root_orientation).as_matrix()
    gravity = Dynamics().effective_gravity(turn, scene_wind(motion)).astype(np.float32)
    poses = zip(motion.positions_for(draper.model.rig), gravity)
    return np.stack([cloud[:, :3] for cloud in draper.layer.drape(poses)])


def motion_roots(motion: Motion) -> np.ndarray:
    """(T, 7) float64, as `Draper.drape` takes roots."""
    return np.concatenate([motion.root_position, motion.root_orientation], axis=1).astype(np.float64)


def evaluate_dynamics(model: GarmentModel, references: Sequence[Reference], device: torch.device) -> dict:
    """Figures of a garment over references, as plain data: `dynamic`, those of all; `scenes`, by name; `counts`.

    In `dynamic`: `rmse_mm`, `moving_rmse_mm`, `velocity_rmse_ms`, `potential_ratio` (incremental potential over the
    simulation's, gravity counted from there), with the same of drapes without sway under `quasi_static`; `at_rest_mm`;
    `stop` and `turn` with overshoot and settling, `turn` also with twist and flare, `swings` with amplitude and phase
    by frequency, each `simulated`, `quasi_static` and `swaying`; of the last two, in clips, `octaves` of the hem's
    velocity and `fold_octaves` of the folds' curvature;
    `rate_divergence_mm`, `drop_divergence_mm`; `strain_percent`, `added_strain_points`; `still_mm`, how far cloth still
    moves in a frame three seconds after a stop; `added_step_us` that time and root add to a step of the evaluator.
    """
    body_model = load_body_model()
    drapers = {
        coefficients.tobytes(): Draper(model, avatar_from_body(body_model, coefficients))
        for coefficients in np.unique(np.concatenate([reference.bodies for reference in references]), axis=0)
    }
    rows = [
        _play(drapers[coefficients.tobytes()], reference, body)
        for reference in references
        for body, coefficients in enumerate(reference.bodies)
    ]
    scenes: dict = {}
    for reference in references:
        of_scene = [row for row in rows if row.reference is reference]
        scenes[reference.motion.name] = _figures(of_scene) | _potentials(of_scene, model, body_model, device)
    swaying = [{name: scene[name] for name in sorted(scene.keys() - {"quasi_static"})} for scene in scenes.values()]
    total: dict = _mean(swaying) | {"quasi_static": _mean([scene["quasi_static"] for scene in scenes.values()])}
    total |= _swinging(rows)
    middle = rows[len(references[0].bodies) // 2].draper
    total |= _robustness(middle, [reference.motion for reference in references])
    total["added_step_us"] = _added_to_step(middle, references[0].motion)
    counts = {"scenes": len(scenes), "sequences": len(rows), "frames": sum(len(row.simulated) for row in rows)}
    return {"dynamic": total, "scenes": scenes, "counts": counts}


def _play(draper: Draper, reference: Reference, body: int) -> Played:
    motion = reference.motion
    count = int(reference.frames[body])
    still = _still(draper, motion)[:count]
    swaying = played(draper, motion, kept=range(count))
    garment = draper.rest_garment
    strains = tuple(float(np.mean(edge_strain(garment, drapes[::10]))) for drapes in (still, swaying))
    points = reference.vertices
    simulated = reference.points[body][:count]
    return Played(reference, body, draper, simulated, still[:, points], swaying[:, points], strains)


def _figures(rows: list[Played]) -> dict:
    def of(drapes: Callable[[Played], np.ndarray]) -> dict[str, float]:
        away = [row.simulated.astype(np.float64) - drapes(row) for row in rows]
        speeds = [np.diff(each, axis=0) * row.reference.motion.rate_hz for each, row in zip(away, rows)]
        return {
            "rmse_mm": 1000 * float(np.mean([_rms(each) for each in away])),
            "moving_rmse_mm": 1000 * float(np.mean([_rms(each - each[0]) for each in away])),
            "velocity_rmse_ms": float(np.mean([_rms(each) for each in speeds])),
        }

    swaying, still = of(lambda row: row.swaying), of(lambda row: row.quasi_static)
    strains = np.mean([row.strains for row in rows], axis=0)
    at_rest = [_rms((row.simulated[:1] - row.quasi_static[:1]).astype(np.float64)) for row in rows]
    return swaying | {
        "at_rest_mm": 1000 * float(np.mean(at_rest)),
        "strain_percent": float(strains[1]),
        "added_strain_points": float(strains[1] - strains[0]),
        "quasi_static": still,
    }


def _rms(values: np.ndarray) -> float:
    """Root of the mean squared length of vectors (..., 3)."""
    return float(np.sqrt((values**2).sum(axis=-1).mean()))


def _potentials(rows: list[Played], model: GarmentModel, body_model: BodyModel, device: torch.device) -> dict:
    """`potential_ratio` with sway, and `quasi_static` without it, on the middle body."""
    row = rows[len(rows) // 2]
    reference, motion = row.reference, row.reference.motion
    frames = np.arange(POTENTIAL_EVERY, len(row.simulated), POTENTIAL_EVERY)
    simulated = {name: values[row.body][frames] for name, values in reference.energies.items()}
    below = simulated["gravity"]
    whole = sum(simulated.values()) - below
    ratios = []
    for drapes in (played(row.draper, motion), _still(row.draper, motion)):
        coefficients = reference.bodies[row.body]
        found = frame_potentials(model, body_model, coefficients, motion, drapes, frames, device)
        ratios.append(float((sum(found.values()) - below).sum() / whole.sum()))
    figures = _figures(rows)["quasi_static"] | {"potential_ratio": ratios[1]}
    return {"potential_ratio": ratios[0], "quasi_static": figures}


def _swinging(rows: list[Played]) -> dict:
    kinds = ("simulated", "quasi_static", "swaying")
    found: dict = {"swings": {}}
    clips = [row for row in rows if row.reference.motion.name not in (*ROOT_SCENES, *ACTED_SCENES)]
    if clips:
        by_clip = [_octaves(row) for row in clips]
        for name in sorted(set.intersection(*map(set, by_clip))):
            found[name] = {kind: _mean([each[name][kind] for each in by_clip]) for kind in kinds[1:]}
    for name in sorted({row.reference.motion.name for row in rows}):
        of_scene = [row for row in rows if row.reference.motion.name == name]
        if name.startswith("swing-"):
            rate = float(name.partition("-")[2])
            found["swings"][f"{rate:g}"] = {
                kind: _mean([swing(getattr(row, kind), row.reference.motion, rate) for row in of_scene])
                for kind in kinds
            }
        elif name in ("stop", "turn"):
            found[name] = {kind: _mean([_ended(row, getattr(row, kind)) for row in of_scene]) for kind in kinds}
    return found


def _octaves(row: Played) -> dict[str, dict[str, dict[str, float]]]:
    """By kind of drape, of the hem's velocity and, if there are points enough, of the folds' curvature."""
    signals = {"octaves": hem_velocity}
    if len(row.reference.vertices) > NEIGHBOURS:
        signals["fold_octaves"] = FoldCurvature(row.draper.rest_garment, row.reference.vertices)
    found = {}
    for name, signal in signals.items():
        simulated = signal(row.simulated)
        found[name] = {
            kind: octaves(signal(getattr(row, kind)), simulated, row.reference.motion.rate_hz)
            for kind in ("quasi_static", "swaying")
        }
    return found


def _ended(row: Played, points: np.ndarray) -> dict[str, float]:
    settled = settling(points, row.simulated, row.reference.motion)
    return settled | turning(points) if row.reference.motion.name == "turn" else settled


def _mean(values: list[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([value[name] for value in values])) for name in values[0]}


def _robustness(draper: Draper, motions: list[Motion]) -> dict[str, float]:
    rates, drops = [], []
    generator = np.random.default_rng(0)
    for motion in motions:
        offsets = []
        for at_rate in map(motion.resampled, RATES):
            frames = np.rint(np.arange(0, 1, 1 / 30) * (at_rate.frame_count - 1)).astype(int)
            # frames of another rate are not at quite the same times: less what drapes without sway differ by
            offsets.append(played(draper, at_rate)[frames] - _still(draper, at_rate)[frames])
        rates += [_rms(each - offsets[-1]) for each in offsets[:-1]]
        kept = np.flatnonzero(generator.random(motion.frame_count) >= LOST)
        drops.append(_rms(played(draper, motion, kept=kept) - played(draper, motion)[kept]))
    stop = next((motion for motion in motions if motion.name == "stop"), motions[0])
    more = np.minimum(np.arange(stop.frame_count + round(60 * STANDING)), stop.frame_count - 1)
    arrays = ("positions", "root_orientation", "root_position")
    standing = replace(stop, **{name: getattr(stop, name)[more] for name in arrays})
    stopped = int(np.flatnonzero(np.diff(stop.root_position[:, 0]) > 1e-6).max(initial=0))
    last = stopped + round(60 * STANDING)
    two = played(draper, standing, kept=range(last + 2))[-2:]
    return {
        "rate_divergence_mm": 1000 * float(np.mean(rates)),
        "drop_divergence_mm": 1000 * float(np.mean(drops)),
        "still_mm": 1000 * float(np.linalg.norm(two[1] - two[0], axis=1).max()),
    }


def _added_to_step(draper: Draper, motion: Motion) -> float:
    """Median processor time [us] that time and root add to a step of the evaluator, as the ROS node and hosts in C take
    it: streams of frames in turns, so that caches are warm."""
    q, roots, down = motion.positions_for(draper.model.rig), motion_roots(motion), motion.gravity
    still, moving = [], []
    for rows, given in ((still, [{"gravity": each} for each in down]), (moving, [{"root": each} for each in roots])):
        frame_input = FrameInput(1)
        for k, each in enumerate(given):
            frame_input.fill(**each, time=k / motion.rate_hz if rows is moving else None)
            rows.append(frame_input.rows.copy())
    pose, out = np.empty(q.shape[1], dtype=np.float32), np.empty((draper.vertex_count, 6), dtype=np.float32)
    medians = []
    for rows in [still, moving] * STREAMS:
        inputs = rows[0].copy()
        step, took = draper.bind_frame(pose, inputs, out), []
        for frame in range(len(q)):
            pose[:], inputs[:] = q[frame], rows[frame]
            begin = time.process_time_ns()
            step()
            took.append(time.process_time_ns() - begin)
        medians.append(np.median(took))
    return float(np.median(np.diff(medians)[::2])) / 1000
