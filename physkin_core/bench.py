"""`physkin bench`: time a frame of a garment and its stages on one thread of this machine, and count its bytes.

Warm is a frame in a loop, which finds everything in caches. Cold is one every 16 ms, as of an avatar at 60 Hz; the
program sleeps in between, and others run. `make bench` in a clone measures more: other engines, emptied caches.
"""

from __future__ import annotations

import argparse
import gc
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter_ns, sleep
from typing import NamedTuple

import numpy as np

from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.machine import machine_line, versions_line
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.loading import load_motion
from physkin_core.outfit.draper import Draper
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import PRECISIONS, Evaluator, supported_instruction_sets
from physkin_core.runtime.frame_input import FrameInput

__all__ = [
    "STAGES",
    "Timing",
    "bound_frame",
    "byte_table",
    "command_parser",
    "main",
    "markdown_table",
    "spread",
    "stage_bytes",
    "stage_frames",
    "stage_table",
    "time_cold",
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

PAUSE = 0.016
"""[s] Before every cold call."""
COLD_TURNS, COLD_REPEATS = 4, 10
"""Most turns with cold calls, and calls a turn: only the first of them finds caches as other calls left them."""


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
    """Print what a frame takes by default, and Markdown tables; write every figure if asked to. Returns 0.

    Raises ValueError for a model that does not exist, or a number of rounds below 1.
    """
    options = command_parser().parse_args(argv)
    if options.rounds < 1:
        raise ValueError(f"--rounds must be 1 or more, got {options.rounds}")
    model, motion = load_garment_model(options.model), load_motion("walk")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    frame_input, middle = FrameInput(1), motion.frame_count // 2
    gravity, pose = motion.gravity[middle], motion.positions_for(model.rig)[middle]
    frame_input.fill(gravity)
    usual, found = Evaluator([draper.bound]), stage_frames(draper.bound, pose, frame_input.rows)
    calls = {
        f"{name}.{stage}": getattr(step, method)
        for name, (_, step) in found.items()
        for stage, method in STAGES.items()
    }
    calls["drape"] = partial(draper.drape, pose, gravity)
    cold = [f"{usual.precision}.{level}.frame" for level in supported_instruction_sets()] + ["drape"]
    figures = {"machine": machine_line(), "versions": versions_line("physkin", "numpy")}
    figures |= {"model": model.name, "vertices": draper.vertex_count}
    figures |= timing_keys(time_in_turns(calls, rounds=options.rounds))
    figures |= timing_keys(time_cold({name: calls[name] for name in cold}, rounds=options.rounds)) | stage_bytes(found)
    print(summary(figures, usual), stage_table(figures), byte_table(figures), sep="\n", end="")
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


def stage_bytes(found: Mapping[str, tuple[Evaluator, object]]) -> dict[str, int]:
    """`PRECISION.ISA.STAGE.bytes` of what `stage_frames` found: what the frame touched."""
    figures = {}
    for name, (evaluator, _) in found.items():
        stages = evaluator.stage_bytes()
        figures |= {f"{name}.{stage}.bytes": count for stage, count in stages.items()}
        figures[f"{name}.frame.bytes"] = sum(stages.values())
    return figures


def timing_keys(timings: Mapping[str, Timing]) -> dict[str, float]:
    """`NAME.us.min`, `NAME.us.p50` and `NAME.us.p99` of each."""
    return {f"{name}.us.{key}": value for name, each in timings.items() for key, value in each._asdict().items()}


def summary(figures: Mapping[str, object], usual: Evaluator) -> str:
    """What a frame takes where nothing else is chosen, as in `usual`, by itself and from Python: a Markdown table."""
    name = f"{usual.precision}.{usual.instruction_set}.frame"
    rows = [[f"frame, {usual.precision} on {usual.instruction_set}", name], ["the same by `Draper.drape`", "drape"]]
    rows = [[label, spread(figures, each), spread(figures, f"cold.{each}")] for label, each in rows]
    header = ["median (fastest, p99)", "µs warm, in a loop", "µs cold, every 16 ms"]
    touched = f"a frame touches {kilobytes(figures, name)} KB"
    table = markdown_table(header, rows)
    return f"{figures['model']}, {figures['vertices']} vertices, {touched}; {figures['machine']}\n\n{table}"


def stage_table(figures: Mapping[str, object]) -> str:
    """Stages of every precision and instruction set as a Markdown table, in µs; and frames that were timed cold."""
    rows = []
    for name in (f"{p}.{level}" for p in PRECISIONS for level in supported_instruction_sets()[::-1]):
        cold = f"cold.{name}.frame"
        times = [typical(figures, f"{name}.{stage}") for stage in STAGES]
        rows.append([*name.split("."), *times, typical(figures, cold) if f"{cold}.us.p50" in figures else ""])
    return markdown_table(["µs: median (fastest)", "instructions", *STAGES, "frame, cold"], rows)


def byte_table(figures: Mapping[str, object]) -> str:
    """KB that stages of every precision touch, with the widest instruction set: others differ by some padding."""
    level = supported_instruction_sets()[-1]
    rows = [[p, *(kilobytes(figures, f"{p}.{level}.{stage}") for stage in STAGES)] for p in PRECISIONS]
    return markdown_table(["KB touched", *STAGES], rows)


def kilobytes(figures: Mapping[str, object], name: str) -> str:
    """Of 1,000 bytes."""
    return f"{figures[f'{name}.bytes'] / 1e3:,.0f}"


def typical(figures: Mapping[str, object], name: str) -> str:
    """Median (fastest)."""
    return "{:.1f} ({:.1f})".format(*(figures[f"{name}.us.{figure}"] for figure in ("p50", "min")))


def spread(figures: Mapping[str, object], name: str) -> str:
    """Median (fastest, 99th percentile)."""
    return "{:.1f} ({:.1f}, {:.1f})".format(*(figures[f"{name}.us.{figure}"] for figure in ("p50", "min", "p99")))


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lines of cells in columns of one width, and an empty line."""
    lines = [header, ["---"] * len(header), *rows]
    widths = [max(map(len, column)) for column in zip(*lines)]
    return "\n".join(["| " + " | ".join(map(str.ljust, cells, widths)) + " |" for cells in lines] + [""])


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


def time_cold(calls: Mapping[str, Callable[[], object]], *, rounds: int) -> dict[str, Timing]:
    """`cold.NAME` -> times of every call where the program sleeps before each: 10 in a row, in at most 4 turns."""
    timings = time_in_turns(
        calls, rounds=min(rounds, COLD_TURNS), repeats=COLD_REPEATS, before_each=partial(sleep, PAUSE)
    )
    return {f"cold.{name}": each for name, each in timings.items()}
