"""`make bench`: `PYTHONPATH=training python -m physkin_bench [MODEL]`."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence

from physkin_bench.cases import model_case, paper_case
from physkin_bench.measurement import measure_case
from physkin_core.bench import command_parser, markdown_table, spread, stage_table
from physkin_core.machine import machine_line, versions_line
from physkin_core.runtime.evaluator import supported_instruction_sets

__all__ = ["main"]

PACKAGES = ("physkin", "numpy", "ai-edge-litert", "warp-lang")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark, print Markdown tables, write the keys of docs/notebook/benchmark.md if asked to."""
    parser = command_parser()
    parser.prog = "python -m physkin_bench"
    parser.add_argument("--no-paper", action="store_true", help="leave out the paper's sizes")
    options = parser.parse_args(argv)
    if options.rounds < 1:
        parser.error(f"rounds must be 1 or more, got {options.rounds}")
    keys = {"machine": machine_line(), "versions": versions_line(*PACKAGES)}
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


def case_tables(figures: Mapping[str, object]) -> str:
    """One case; times are µs, median (fastest, 99th percentile)."""

    lines = [f"## {figures['model']}: {figures['vertices']} vertices, {figures['network_weights']} network weights", ""]
    lines.append(stage_table(figures))

    timed = [key.removesuffix(".us.p50") for key in figures if key.endswith(".us.p50")]
    others = [name for name in timed if name.split(".")[0] in ("separate_limbs", "cold")]
    lines.append(markdown_table(["", "µs"], [[name, spread(figures, name)] for name in others]))
    rows = []
    for name in (name for name in timed if name.startswith("peers.")):
        ours = f"{'int8' if name.endswith('int8') else 'fp32'}.{supported_instruction_sets()[-1]}"
        stages = ["networks"] if ".networks." in name else ["skinning", "normals"]
        times = figures[f"{name}.us.p50"] / sum(figures[f"{ours}.{stage}.us.p50"] for stage in stages)
        rows.append([name, spread(figures, name), f"{ours}.{' + '.join(stages)}", f"{times:.2f}"])
    lines.append(markdown_table(["peer", "µs", "ours", "times as fast"], rows))
    errors = [key for key in figures if key.startswith("error.")]
    lines.append(markdown_table(["error", "mm"], [[key, f"{figures[key]:.3g}"] for key in errors]))
    return "\n".join(lines + [f"missing: {name}: {reason}" for name, reason in figures["missing"].items()])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
