"""Figures of cloth in motion: drapes with sway, and without, against references of simulated cloth.

`at_rest_mm` is what a model's drape without sway is away from the simulation before anything moves;
`moving_rmse_mm` is the distance less that of the first frame, vertex by vertex.

Dimensions: `T` frames, `k` points below the hips, `n` garment vertices. Metres, root frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.motion.motion import Motion
from physkin_core.outfit.draper import Draper
from physkin_core.quality import edge_strain
from physkin_core.rig.rig import Rig
from physkin_training.dynamics.reference import Reference, load_reference
from physkin_training.dynamics.scenes import scene_wind
from physkin_training.energies.motion import Dynamics

__all__ = ["evaluate_dynamics", "played", "references_of", "settling", "swing"]

LOWEST = 0.34
"""Share of the points, the lowest, that are the hem."""
SETTLED = 0.1
"""Cloth has settled when it stays within this share of the simulation's largest displacement after the stop."""
STEADY_FROM = 1.6
"""[s] from the beginning of a scene until the root's swing is steady."""
KINDS = ("simulated", "quasi_static", "swaying")


@dataclass(frozen=True)
class Played:
    """One reference on one body: points (T, k, 3) of the simulation and of drapes without and with sway, and the mean
    edge strain of the latter two [%]."""

    motion: Motion
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


def played(draper: Draper, motion: Motion) -> np.ndarray:
    """Whole drapes (T, n, 3) float32 with sway, from hanging still."""
    draper.reset()
    drapes = []
    for k, (positions, wind) in enumerate(zip(motion.positions_for(draper.model.rig), scene_wind(motion))):
        draper.wind = wind
        drapes.append(draper.drape(positions, time=k / motion.rate_hz, root=motion.root[k])[:, :3])
    draper.wind = np.zeros(3)
    return np.stack(drapes)


def evaluate_dynamics(model: GarmentModel, references: Sequence[Reference]) -> dict:
    """Figures of a garment over references, as plain data: `dynamic`, those of all; `scenes`, by name; `counts`.

    In `dynamic`: `rmse_mm`, `moving_rmse_mm`, `at_rest_mm`, `strain_percent`, `added_strain_points`, with the first two
    of drapes without sway under `quasi_static`; `stop` and `turn` with overshoot and settling, `swings` with amplitude
    and phase by frequency, each `simulated`, `quasi_static` and `swaying`.
    """
    body_model = load_body_model()
    bodies = np.unique(np.concatenate([reference.bodies for reference in references]), axis=0)
    drapers = {body.tobytes(): Draper(model, avatar_from_body(body_model, body)) for body in bodies}
    scenes, by_kind = {}, {}
    for reference in references:
        name = reference.motion.name
        rows = [_play(drapers[body.tobytes()], reference, k) for k, body in enumerate(reference.bodies)]
        scenes[name] = _figures(rows)
        if name.startswith("swing-"):
            rate = float(name.partition("-")[2])
            by_kind[name] = {
                kind: _mean([swing(getattr(row, kind), row.motion, rate) for row in rows]) for kind in KINDS
            }
        elif name in ("stop", "turn"):
            by_kind[name] = {
                kind: _mean([settling(getattr(row, kind), row.simulated, row.motion) for row in rows]) for kind in KINDS
            }
    total = _mean([{k: v for k, v in scene.items() if k != "quasi_static"} for scene in scenes.values()])
    total |= {"quasi_static": _mean([scene["quasi_static"] for scene in scenes.values()])}
    total |= {"swings": {f"{float(k[6:]):g}": v for k, v in by_kind.items() if k.startswith("swing-")}}
    total |= {name: by_kind[name] for name in ("stop", "turn") if name in by_kind}
    frames = sum(int(reference.frames.sum()) for reference in references)
    sequences = sum(len(reference.bodies) for reference in references)
    return {
        "dynamic": total,
        "scenes": scenes,
        "counts": {"scenes": len(scenes), "sequences": sequences, "frames": frames},
    }


def _play(draper: Draper, reference: Reference, body: int) -> Played:
    motion, simulated = reference.motion, reference.simulated(body)
    turn = Rotation.from_quat(motion.root_orientation).as_matrix()
    gravity = Dynamics().effective_gravity(turn, scene_wind(motion)).astype(np.float32)
    still = draper.layer.drape(zip(motion.positions_for(draper.model.rig), gravity))
    drapes = [np.stack([cloud[:, :3] for cloud in still]), played(draper, motion)]
    drapes = [each[: len(simulated)] for each in drapes]
    points = swinging_vertices(draper.model.garment, draper.model.rig)
    strains = tuple(float(np.mean(edge_strain(draper.rest_garment, each[::10]))) for each in drapes)
    return Played(motion, *(each[:, points].astype(np.float64) for each in (simulated, *drapes)), strains)


def swinging_vertices(garment: Garment, rig: Rig) -> np.ndarray:
    """Vertices below the hips at rest, (k,); all where there are none."""
    hips = [k for k, name in enumerate(rig.bone_names) if name.startswith("upperleg01")]
    below = np.flatnonzero(garment.vertices[:, 2] < rig.heads[hips, 2].min()) if hips else np.empty(0, dtype=int)
    return below if len(below) else np.arange(len(garment.vertices))


def _figures(rows: Sequence[Played]) -> dict:
    def of(kind: str) -> dict[str, float]:
        away = [getattr(row, kind) - row.simulated for row in rows]
        return {
            "rmse_mm": 1000 * float(np.mean([_rms(each) for each in away])),
            "moving_rmse_mm": 1000 * float(np.mean([_rms(each - each[0]) for each in away])),
        }

    still, swaying = np.mean([row.strains for row in rows], axis=0)
    return of("swaying") | {
        "at_rest_mm": 1000 * float(np.mean([_rms(row.quasi_static[0] - row.simulated[0]) for row in rows])),
        "strain_percent": float(swaying),
        "added_strain_points": float(swaying - still),
        "quasi_static": of("quasi_static"),
    }


def _rms(values: np.ndarray) -> float:
    """Root of the mean squared length of vectors (..., 3)."""
    return float(np.sqrt((values**2).sum(axis=-1).mean()))


def _mean(values: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([value[name] for value in values])) for name in values[0]}


def swing(points: np.ndarray, motion: Motion, rate_hz: float) -> dict[str, float]:
    """Amplitude [mm] of the hem of points (T, k, 3) sideways against the root, and phase [degrees] after the root's
    displacement, at the rate of the root."""
    sideways = _hem(points)[:, :, 1].mean(axis=1)
    times = np.arange(len(sideways)) / motion.rate_hz
    steady = times >= STEADY_FROM
    basis = np.stack([np.sin(2 * np.pi * rate_hz * times), np.cos(2 * np.pi * rate_hz * times), np.ones_like(times)], 1)

    def fitted(signal: np.ndarray) -> complex:
        sine, cosine, _ = np.linalg.lstsq(basis[steady], signal[steady], rcond=None)[0]
        return complex(sine, cosine)

    cloth, root = fitted(sideways), fitted(motion.root_position[: len(sideways), 1].astype(np.float64))
    return {"amplitude_mm": 1000 * abs(cloth), "phase_degrees": float(np.degrees(np.angle(cloth / root)))}


def settling(points: np.ndarray, simulated: np.ndarray, motion: Motion) -> dict[str, float]:
    """After the root's stop: the largest displacement [mm] of the hem of points (T, k, 3) from where it ends, and the
    time [s] from which it stays within a tenth of the simulation's largest."""
    moves = np.abs(np.diff(motion.root[: len(points)], axis=0)).max(axis=1)
    stop = int(np.flatnonzero(moves > 1e-5).max(initial=0)) + 1

    def displacement(of: np.ndarray) -> np.ndarray:
        hem = _hem(of)[stop:]
        return np.sqrt(((hem - hem[-1]) ** 2).sum(axis=2).mean(axis=1))

    own, limit = displacement(points), SETTLED * displacement(simulated).max()
    outside = np.flatnonzero(own > limit)
    return {
        "overshoot_mm": 1000 * float(own.max()),
        "settling_s": float((outside.max() + 1) / motion.rate_hz) if len(outside) else 0.0,
    }


def _hem(points: np.ndarray) -> np.ndarray:
    order = np.argsort(points[0, :, 2])
    return points[:, order[: max(1, round(LOWEST * points.shape[1]))]]
