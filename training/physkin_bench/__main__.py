"""`make bench`: `PYTHONPATH=training python -m physkin_bench [MODEL]`."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from functools import partial

import numpy as np

from physkin_bench.cases import BenchmarkCase, model_case, paper_case
from physkin_core.bench import (
    STAGES,
    command_parser,
    markdown_table,
    spread,
    stage_frames,
    stage_table,
    time_in_turns,
    timing_keys,
)
from physkin_core.machine import machine_line, versions_line
from physkin_core.native_module import native
from physkin_core.runtime.evaluator import PRECISIONS, Evaluator, supported_instruction_sets
from physkin_core.separation.limb_separator import SeparationSettings

__all__ = ["main"]

COLD_ROUNDS = 30
"""Most turns with cold caches, which take long."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark, print Markdown tables, write the keys of docs/notebook/benchmark.md if asked to."""
    parser = command_parser()
    parser.prog = "python -m physkin_bench"
    parser.add_argument("--no-paper", action="store_true", help="leave out the paper's sizes")
    options = parser.parse_args(argv)
    if options.rounds < 1:
        parser.error(f"rounds must be 1 or more, got {options.rounds}")
    keys = {"machine": machine_line(), "versions": versions_line("physkin", "numpy")}
    print("\n".join(f"{key}: {value}" for key, value in keys.items()) + "\n")
    cases = [("", lambda: model_case(options.model))]
    cases += [] if options.no_paper else [("paper.", paper_case)]
    for prefix, make in cases:
        figures = measure_case(make(), rounds=options.rounds)
        keys |= {prefix + key: value for key, value in figures.items()}
        print(case_tables(figures) + "\n", flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps(keys, indent=1) + "\n")
    return 0


def measure_case(case: BenchmarkCase, *, rounds: int) -> dict[str, object]:
    """Time everything there is for a case. rounds: turns that each thing to time gets.

    Returns the keys of docs/notebook/benchmark.md, of which times are microseconds.
    """
    middle = len(case.joint_positions) // 2
    bound, pose, inputs = case.bound, case.joint_positions[middle].copy(), case.inputs[middle].copy()
    found, levels = stage_frames(bound, pose, inputs), supported_instruction_sets()
    evaluators, steps = ({p: found[f"{p}.{levels[-1]}"][k] for p in PRECISIONS} for k in (0, 1))
    calls = {f"{name}.{stage}": getattr(found[name][1], method) for name in found for stage, method in STAGES.items()}
    if case.limbs is not None:
        shape, arms_down = case.limbs
        for level in levels:
            separator = native.LimbSeparator(shape, *astuple(SeparationSettings()), level)
            calls[f"separate_limbs.{level}"] = partial(separator.separate, arms_down, np.empty_like(arms_down))
    timings = time_in_turns(calls, rounds=rounds)
    cold = {
        f"cold.{stage}.{p}": getattr(steps[p], STAGES[stage]) for stage in ("frame", "networks") for p in PRECISIONS
    }
    filler = np.zeros(128 << 17)  # four times what last-level caches usually hold for a core
    flush = partial(np.add, filler, 1, out=filler)
    timings |= time_in_turns(cold, rounds=min(rounds, COLD_ROUNDS), repeats=1, before_each=flush)

    layers = (*bound.pose_layers, *bound.deformer_layers, *bound.detail_layers)
    figures: dict[str, object] = {
        "model": case.name,
        "vertices": len(bound.vertices),
        "features": len(evaluators["fp32"].features()),
        "network_weights": sum(weight.size for weight, _ in layers),
    }
    figures |= timing_keys(timings)
    for precision in ("bf16", "int8"):
        errors = _errors(case, evaluators["fp32"], evaluators[precision])
        figures |= {f"error.{precision}.vertices.mm.{name}": value for name, value in errors.items()}
    return figures


def _errors(case: BenchmarkCase, exact: Evaluator, evaluator: Evaluator) -> dict[str, float]:
    """[mm] Of rounded network weights, over the case's poses."""
    out, expected = np.empty((2, len(case.bound.vertices), 6), dtype=np.float32)
    distances = []
    for pose, inputs in zip(case.joint_positions, case.inputs):
        evaluator.evaluate(pose, inputs, [out])
        exact.evaluate(pose, inputs, [expected])
        distances.append(1e3 * np.linalg.norm(out[:, :3].astype(np.float64) - expected[:, :3], axis=1))
    figures = {"mean": np.mean(distances), "p99": np.percentile(distances, 99), "max": np.max(distances)}
    return {name: float(value) for name, value in figures.items()}


def case_tables(figures: Mapping[str, object]) -> str:
    """One case; times are µs, median (fastest, 99th percentile)."""
    lines = [f"## {figures['model']}: {figures['vertices']} vertices, {figures['network_weights']} network weights", ""]
    lines.append(stage_table(figures))
    timed = [key.removesuffix(".us.p50") for key in figures if key.endswith(".us.p50")]
    others = [name for name in timed if name.split(".")[0] in ("separate_limbs", "cold")]
    lines.append(markdown_table(["", "µs"], [[name, spread(figures, name)] for name in others]))
    errors = [key for key in figures if key.startswith("error.")]
    lines.append(markdown_table(["error", "mm"], [[key, f"{figures[key]:.3g}"] for key in errors]))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
