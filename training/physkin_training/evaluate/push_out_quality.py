"""What the push-out reaches and costs: exact distances to the body, strain and jitter, without it and with it.

`python -m physkin_training.evaluate.push_out_quality [MODEL ...]` prints a Markdown table: held-out bodies, every
frame of the bundled motions and poses uniform in the limits; minutes a model.

Where a body meets itself, cloth between the two parts has nowhere to go. Such vertices are counted apart: the skin
nearest to the vertex, or the skin it lies on at the canonical pose, is itself inside the body.
Dimensions: `F` frames, `B` of them a batch, `n` garment vertices. Metres, root frame.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
import warp as wp

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.model_file import load_garment_model, shipped_models
from physkin_core.motion.motion import bundled_motions, load_motion
from physkin_core.quality import edge_strain
from physkin_core.runtime.draper import Draper
from physkin_core.runtime.native_evaluator import NativeEvaluator
from physkin_core.runtime.push_out import TOLERATED_DEPTH, bind_push_out
from physkin_training.evaluate.body_overlap import OFF_SKIN, Seats, is_covered, winding
from physkin_training.sampling.evaluation_pairs import uniform_pairs
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

__all__ = ["PushOutQuality", "main", "measure_push_out"]

BODIES, POSES, BATCH = 4, 64, 16
REACH = 0.2
"""Vertices farther [m] than this from any skin count as outside."""
TIMED_FRAMES, TIMED_CALLS = 24, 15


@dataclass
class Counts:
    """Of vertices over frames: `vertices` in all; deeper than 0.5 mm where the body does not meet itself and where it
    does; the deepest [mm] of either."""

    vertices: int = 0
    deep: int = 0
    deep_at_meeting: int = 0
    deepest: float = 0.0
    deepest_at_meeting: float = 0.0
    frames_with_deep: int = 0


@dataclass(frozen=True)
class PushOutQuality:
    """Figures of one model. before, after: without and with the push-out.

    added_strain: mean edge strain it adds [points]. jitter_ratio: mean second difference of vertex positions in motion,
    with over without. largest_step: most that the push of a vertex changes from one frame of motion to the next [mm];
    step_p9999: the 99.99th percentile. missed: vertices counted in `after` beyond those the frames' own residuals
    count, and `residual` what these count. microseconds: median and fastest of the stage. bind_seconds: median.
    """

    before: Counts
    after: Counts
    added_strain: float
    jitter_ratio: float
    largest_step: float
    step_p9999: float
    residual: int
    microseconds: tuple[float, float]
    bind_seconds: float


@wp.kernel
def contact_kernel(
    x: wp.array2d(dtype=wp.vec3),
    mesh: wp.uint64,
    offset: wp.array(dtype=wp.vec3),
    seat_face: wp.array(dtype=wp.int32),
    seat_place: wp.array(dtype=wp.vec2),
    faces_a_body: wp.int32,
    tolerated: wp.float32,
    distance: wp.array2d(dtype=wp.float32),
    at_meeting: wp.array2d(dtype=wp.bool),
):
    """Signed distance, and for vertices that are too deep whether the body meets itself there."""
    s, v = wp.tid()
    point = x[s, v] + offset[s]
    distance[s, v] = REACH
    at_meeting[s, v] = False
    hit = wp.mesh_query_point_sign_normal(mesh, point, REACH)
    if hit.result:
        closest = wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v)
        distance[s, v] = hit.sign * wp.length(point - closest)
        if distance[s, v] < -tolerated:
            outside = closest + OFF_SKIN * wp.normalize(closest - point)
            covered = is_covered(mesh, s * faces_a_body + seat_face[v], seat_place[v])
            at_meeting[s, v] = covered or winding(mesh, outside) > 0


class ExactContact:
    """Exact contact of drapes (F, n, 3) with one held-out body in as many poses (F, d)."""

    def __init__(self, body: int, rest: np.ndarray) -> None:
        device = torch.device("cpu")
        model = load_body_model()
        self._posed = PosedBodies(model, BodySet(model, model.held_out_bodies[[body]], device), BATCH)
        self._faces = len(model.faces)
        self._seats = Seats(model.vertices(model.held_out_bodies[body]), model.faces, rest)

    def __call__(self, positions: np.ndarray, *drapes: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each of the drapes: signed distances (F, n) and whether the body meets itself there (F, n), looked at
        where they are too deep."""
        results: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in drapes]
        for rows in self._posed.pose_in_turn(positions):
            for drape, result in zip(drapes, results, strict=True):
                points = wp.array(np.ascontiguousarray(drape[rows, :, :3]), dtype=wp.vec3, device="cpu")
                distance = wp.zeros(points.shape, dtype=wp.float32, device="cpu")
                meeting = wp.zeros(points.shape, dtype=wp.bool, device="cpu")
                offset = wp.from_torch(self._posed.offset, dtype=wp.vec3)
                inputs = [points, self._posed.mesh.id, offset, self._seats.face, self._seats.place, self._faces]
                inputs.append(TOLERATED_DEPTH)
                wp.launch(contact_kernel, distance.shape, inputs, [distance, meeting], device="cpu")
                result.append((distance.numpy(), meeting.numpy()))
        return [tuple(np.concatenate(part) for part in zip(*result, strict=True)) for result in results]


def measure_push_out(model: GarmentModel, *, bodies: int = BODIES, poses: int = POSES) -> PushOutQuality:
    """Drape one model without and with push-out. bodies: held-out adults, spread evenly. poses: uniform ones a body."""
    body_model = load_body_model()
    before, after = Counts(), Counts()
    strain, jitter = [], np.zeros(2)
    steps, microseconds, bind_seconds, residual = [], [], [], 0
    for body in np.linspace(0, len(body_model.held_out_bodies) - 1, bodies).astype(int):
        avatar = avatar_from_body(body_model, body_model.held_out_bodies[body])
        draper = Draper(model, avatar)
        started = perf_counter()
        bound = bind_push_out(draper.drape, model.rig, avatar)
        bind_seconds.append(perf_counter() - started)
        pushing = NativeEvaluator(draper.bound, push_out=bound)
        exact = ExactContact(body, draper.drape(model.rig.rest)[:, :3])
        for moving, positions, gravity in _takes(model, poses):
            drapes = np.empty((2, len(positions), draper.vertex_count, 6), dtype=np.float32)
            left = []
            for frame, q in enumerate(positions):
                draper.drape(q, gravity[frame], out=drapes[0, frame])
                pushing.evaluate(q, gravity[frame], drapes[1, frame])
                left.append(pushing.residual)
            residual += sum(r.left_inside for r in left)
            for counts, (distance, meeting) in zip((before, after), exact(positions, *drapes), strict=True):
                _count_in(counts, distance, meeting)
            places = drapes[..., :3]
            strain.append(edge_strain(model.garment, places[1]) - edge_strain(model.garment, places[0]))
            if moving:
                second = np.linalg.norm(np.diff(places, n=2, axis=1), axis=-1)
                jitter += second.sum(axis=(1, 2), dtype=np.float64)
                steps.append(1e3 * np.linalg.norm(np.diff(places[1] - places[0], axis=0), axis=-1).astype(np.float32))
                microseconds += _timed(pushing, positions, gravity, drapes[1, 0])
    step = np.concatenate([s.ravel() for s in steps])
    return PushOutQuality(
        before=before,
        after=after,
        added_strain=float(np.concatenate(strain).mean()),
        jitter_ratio=float(jitter[1] / jitter[0]),
        largest_step=float(step.max()),
        step_p9999=float(np.quantile(step, 0.9999)),
        residual=residual,
        microseconds=(float(np.median(microseconds)), float(np.min(microseconds))),
        bind_seconds=float(np.median(bind_seconds)),
    )


def _takes(model: GarmentModel, poses: int) -> Iterator[tuple[bool, np.ndarray, np.ndarray]]:
    """Whether it is motion, joint positions (F, d) and gravity (F, 3), float32."""
    for name in bundled_motions():
        motion = load_motion(name)
        yield True, motion.positions_for(model.rig).astype(np.float32), motion.gravity.astype(np.float32)
    pairs = uniform_pairs(model.rig, bodies=1, poses=poses, seed=0, upright=True)
    yield False, pairs.positions.numpy(), pairs.gravity.numpy()


def _count_in(counts: Counts, distance: np.ndarray, meeting: np.ndarray) -> None:
    deep = distance < -TOLERATED_DEPTH
    counts.vertices += distance.size
    counts.deep += int((deep & ~meeting).sum())
    counts.deep_at_meeting += int((deep & meeting).sum())
    counts.frames_with_deep += int((deep & ~meeting).any(axis=1).sum())
    counts.deepest = max(counts.deepest, float(-1e3 * distance[deep & ~meeting].min(initial=0)))
    counts.deepest_at_meeting = max(counts.deepest_at_meeting, float(-1e3 * distance[deep & meeting].min(initial=0)))


def _timed(evaluator: NativeEvaluator, positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> list[float]:
    """Microseconds of the stage, median of some calls each, over frames spread evenly."""
    medians = []
    for frame in np.linspace(0, len(positions) - 1, min(TIMED_FRAMES, len(positions))).astype(int):
        step = evaluator.bind_step(positions[frame], gravity[frame], out)
        step.step()
        times = []
        for _ in range(TIMED_CALLS):
            step.skin()
            started = perf_counter()
            step.push_out()
            times.append(1e6 * (perf_counter() - started))
        medians.append(float(np.median(times)))
    return medians


def main(argv: Sequence[str] | None = None) -> int:
    """Prints one table over the models. argv: default the command line's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", default=shipped_models(), help="garment model files or shipped names")
    parser.add_argument("--bodies", type=int, default=BODIES, help="held-out adults (default %(default)s)")
    parser.add_argument("--poses", type=int, default=POSES, help="uniform poses a body (default %(default)s)")
    options = parser.parse_args(argv)
    print(
        "| | deeper than 0.5 mm %: before | after | frames with any | deepest mm: before | after "
        "| where the body meets itself %: before | after | deepest mm | residual's count, % | strain, points "
        "| jitter ratio | step mm: p99.99 | largest | us: median (fastest) | set-up s |\n" + "|---" * 16 + "|"
    )
    for path in options.models:
        q = measure_push_out(load_garment_model(path), bodies=options.bodies, poses=options.poses)
        share = 100 / q.before.vertices
        print(
            f"| {Path(path).stem} | {share * q.before.deep:.5f} | {share * q.after.deep:.5f} "
            f"| {q.before.frames_with_deep} to {q.after.frames_with_deep} "
            f"| {q.before.deepest:.1f} | {q.after.deepest:.1f} "
            f"| {share * q.before.deep_at_meeting:.4f} | {share * q.after.deep_at_meeting:.4f} "
            f"| {q.after.deepest_at_meeting:.1f} | {share * q.residual:.4f} | {q.added_strain:+.4f} "
            f"| {q.jitter_ratio:.3f} | {q.step_p9999:.2f} | {q.largest_step:.1f} "
            f"| {q.microseconds[0]:.1f} ({q.microseconds[1]:.1f}) | {q.bind_seconds:.1f} |",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
