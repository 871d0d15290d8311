"""`physkin bench`: time a frame of a garment and its stages on one thread of this machine.

`make bench` in a clone measures more: other engines, cold caches.
"""

from __future__ import annotations

import argparse
import gc
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter_ns
from typing import NamedTuple

import numpy as np

from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.machine import machine_line, versions_line
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.loading import load_motion
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import PRECISIONS, Evaluator, supported_instruction_sets
from physkin_core.runtime.frame_input import FrameInput

__all__ = [
    "STAGES",
    "Timing",
    "bound_frame",
    "command_parser",
    "main",
    "markdown_table",
    "spread",
    "stage_frames",
    "stage_table",
    "time_in_turns",
    "timing_keys",
]

STAGES = {
    "posing": "pose",
    "networks": "run_networks",
    "composition": "compose_nodes",
    "skinning": "skin",
    "normals": "compute_normals",
    "frame": "step",
}
"""Stage -> method of a bound frame. Normals that skinning carries along are no stage of their own."""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin bench`."""
    parser = argparse.ArgumentParser(prog="physkin bench", description=__doc__.split("`: ")[1].splitlines()[0])
    parser.add_argument("model", nargs="?", default="tshirt", help="garment model (default %(default)s)")
    parser.add_argument(
        "--rounds", type=int, default=100, metavar="N", help="rounds of 5 frames each (default %(default)s)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure to this file")
    return parser


def main(argv: Sequence[str]) -> int:
    """Print the times as a Markdown table, write them if asked to. Returns 0.

    Raises ValueError for a model that does not exist, or a number of rounds below 1.
    """
    options = command_parser().parse_args(argv)
    if options.rounds < 1:
        raise ValueError(f"--rounds must be 1 or more, got {options.rounds}")
    model, motion = load_garment_model(options.model), load_motion("walk")
    bound = bind_garment(model, load_avatar(BUNDLED_AVATAR, model.rig))
    frame_input, middle = FrameInput(1), motion.frame_count // 2
    frame_input.fill(motion.gravity[middle])
    pose = motion.positions_for(model.rig)[middle]
    calls = {
        f"{name}.{stage}": getattr(step, method)
        for name, (_, step) in stage_frames(bound, pose, frame_input.rows).items()
        for stage, method in STAGES.items()
    }
    figures = {"machine": machine_line(), "versions": versions_line("physkin", "numpy")}
    figures |= {"model": model.name, "vertices": len(bound.vertices)}
    figures |= timing_keys(time_in_turns(calls, rounds=options.rounds))
    print(f"{model.name}, {len(bound.vertices)} vertices; {figures['machine']}\n\n{stage_table(figures)}")
    usual = Evaluator([bound])
    median = figures[f"{usual.precision}.{usual.instruction_set}.frame.us.p50"]
    print(f"by default, with {usual.precision} on {usual.instruction_set}, a frame takes {median:.1f} µs here")
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


def stage_frames(bound: BoundGarment, pose: np.ndarray, inputs: np.ndarray) -> dict[str, tuple[Evaluator, object]]:
    """`PRECISION.ISA` -> evaluator of a bound garment, and its bound frame at a pose (d,) [rad] and inputs (1, 13)."""
    found = {}
    for level in supported_instruction_sets():
        for precision in PRECISIONS:
            evaluator = Evaluator([bound], instruction_set=level, precision=precision)
            found[f"{precision}.{level}"] = evaluator, bound_frame(evaluator, bound, pose, inputs)
    return found


def bound_frame(evaluator: Evaluator, bound: BoundGarment, pose: np.ndarray, inputs: np.ndarray):
    """A bound frame of an evaluator that has been run once."""
    out = np.empty((len(bound.vertices), 6), dtype=np.float32)
    frame = evaluator.bind_frame(pose.astype(np.float32), inputs, [out])
    frame.step()
    return frame


def timing_keys(timings: Mapping[str, Timing]) -> dict[str, float]:
    """`NAME.us.min`, `NAME.us.p50` and `NAME.us.p99` of each."""
    return {f"{name}.us.{key}": value for name, each in timings.items() for key, value in each._asdict().items()}


def stage_table(figures: Mapping[str, object]) -> str:
    """Stages of every precision and instruction set as a Markdown table, in µs."""
    levels = supported_instruction_sets()[::-1]
    rows = [
        [p, level, *(spread(figures, f"{p}.{level}.{stage}") for stage in STAGES)]
        for p in PRECISIONS
        for level in levels
    ]
    return markdown_table(["µs: median (fastest, p99)", "instructions", *STAGES], rows)


def spread(figures: Mapping[str, object], name: str) -> str:
    """Median (fastest, 99th percentile)."""
    return "{:.1f} ({:.1f}, {:.1f})".format(*(figures[f"{name}.us.{figure}"] for figure in ("p50", "min", "p99")))


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lines of cells, and an empty line."""
    return "\n".join(["| " + " | ".join(cells) + " |" for cells in (header, ["---"] * len(header), *rows)] + [""])


class Timing(NamedTuple):
    """Microseconds a call: the fastest, the median and the 99th percentile."""

    min: float
    p50: float
    p99: float


def time_in_turns(
    calls: Mapping[str, Callable[[], object]],
    *,
    rounds: int,
    repeats: int = 5,
    before_each: Callable[[], object] | None = None,
) -> dict[str, Timing]:
    """Time every call `rounds` x `repeats` times, round robin.

    A turn starts with one call that is not timed, so that the timed ones find what the call itself leaves in caches.
    before_each: run, untimed, before every timed call (to empty the caches); the untimed call is left out then.
    Each sample holds about 0.1 µs of Python.
    """
    samples: dict[str, list[int]] = {name: [] for name in calls}
    collecting = gc.isenabled()
    gc.disable()
    try:
        for _ in range(rounds):
            for name, call in calls.items():
                if before_each is None:
                    call()
                for _ in range(repeats):
                    if before_each is not None:
                        before_each()
                    start = perf_counter_ns()
                    call()
                    samples[name].append(perf_counter_ns() - start)
    finally:
        if collecting:
            gc.enable()
    return {
        name: Timing(*np.percentile(np.array(taken) / 1e3, [0, 50, 99]).tolist()) for name, taken in samples.items()
    }
