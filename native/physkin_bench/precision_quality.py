"""What network weights in less than fp32 cost in quality: shipped models on held-out bodies in the bundled motions.

`python -m physkin_bench.precision_quality [MODEL ...]` prints a Markdown table; exact distances to the body take
minutes a model.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, shipped_models
from physkin_core.motion.motion import bundled_motions, load_motion
from physkin_core.quality import edge_strain, signed_distance
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.native_evaluator import PRECISIONS, NativeEvaluator

__all__ = ["PrecisionQuality", "main", "measure_precision_quality"]

BODIES, FRAMES_A_MOTION = 6, 6
TOLERATED_DEPTH = 0.0005
"""[m] what counts as inside the body in `deeper`."""


@dataclass(frozen=True)
class PrecisionQuality:
    """Figures of one model in one precision, over the same poses of the same bodies.

    edge_strain [%]. inside, deeper: share of vertices inside the body, and deeper than 0.5 mm [%]. mean, p99, largest:
    distance of a vertex from where fp32 puts it [mm].
    """

    edge_strain: float
    inside: float
    deeper: float
    mean: float
    p99: float
    largest: float


def measure_precision_quality(
    model: GarmentModel, *, bodies: int = BODIES, frames_a_motion: int = FRAMES_A_MOTION
) -> dict[str, PrecisionQuality]:
    """Drape one model in every precision. bodies: held-out adults, spread evenly. Returns figures by precision."""
    strains: dict[str, list[float]] = {name: [] for name in PRECISIONS}
    depths: dict[str, list[np.ndarray]] = {name: [] for name in PRECISIONS}
    moved: dict[str, list[np.ndarray]] = {name: [] for name in PRECISIONS}
    for avatar in _held_out(model, bodies):
        bound = bind_garment(model, avatar, backend="native")
        evaluators = {name: NativeEvaluator(bound, precision=name) for name in PRECISIONS}
        for positions, gravity in _poses(model, frames_a_motion):
            body = avatar.posed_vertices(model.rig.bone_transforms(positions, heads=avatar.bone_heads))
            exact = np.empty((len(bound.vertices), 3), dtype=np.float32)
            evaluators["fp32"].evaluate(positions, gravity, exact)
            for name, evaluator in evaluators.items():
                out = np.empty_like(exact)
                evaluator.evaluate(positions, gravity, out)
                strains[name].append(float(edge_strain(model.garment, out)))
                depths[name].append(-signed_distance(out, body, avatar.faces))
                moved[name].append(1e3 * np.linalg.norm(out.astype(np.float64) - exact, axis=1))
    return {
        name: PrecisionQuality(
            edge_strain=float(np.mean(strains[name])),
            inside=100 * float(np.mean(np.array(depths[name]) > 0)),
            deeper=100 * float(np.mean(np.array(depths[name]) > TOLERATED_DEPTH)),
            mean=float(np.mean(moved[name])),
            p99=float(np.percentile(moved[name], 99)),
            largest=float(np.max(moved[name])),
        )
        for name in PRECISIONS
    }


def _held_out(model: GarmentModel, count: int) -> Iterator[Avatar]:
    body = load_body_model()
    for index in np.linspace(0, len(body.held_out_bodies) - 1, count).astype(int):
        yield avatar_from_body(body, body.held_out_bodies[index])


def _poses(model: GarmentModel, frames: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for name in bundled_motions():
        motion = load_motion(name)
        positions = motion.positions_for(model.rig)
        for frame in np.linspace(0, motion.frame_count - 1, frames).astype(int):
            yield positions[frame].astype(np.float32), motion.gravity[frame].astype(np.float32)


def main(argv: Sequence[str] | None = None) -> int:
    """Prints one table over the models. argv: default the command line's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", default=shipped_models(), help="garment model files or shipped names")
    parser.add_argument("--bodies", type=int, default=BODIES, help="held-out adults (default %(default)s)")
    parser.add_argument("--frames", type=int, default=FRAMES_A_MOTION, help="of each motion (default %(default)s)")
    options = parser.parse_args(argv)
    print("| | edge strain % | change, points | inside % | deeper than 0.5 mm % | moved mm: mean | p99 | largest |")
    print("|---|---|---|---|---|---|---|---|")
    for path in options.models:
        figures = measure_precision_quality(
            load_garment_model(path), bodies=options.bodies, frames_a_motion=options.frames
        )
        for name, q in figures.items():
            change = q.edge_strain - figures["fp32"].edge_strain
            print(
                f"| {Path(path).stem} {name} | {q.edge_strain:.3f} | {change:+.4f} | {q.inside:.4f} | {q.deeper:.4f} "
                f"| {q.mean:.3f} | {q.p99:.3f} | {q.largest:.2f} |",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
