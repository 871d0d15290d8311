"""`make bench`: `PYTHONPATH=training python -m physkin_bench [MODEL]`."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence

from physkin_bench.cases import model_case, paper_case
from physkin_bench.measurement import compared_levels, measure_case
from physkin_core.bench import byte_table, command_parser, markdown_table, spread, stage_table
from physkin_core.machine import machine_line, versions_line

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
    lines += [stage_table(figures), byte_table(figures)]

    timed = [key.removesuffix(".us.p50") for key in figures if key.endswith(".us.p50")]
    others = [name for name in timed if name.startswith(("separate_limbs.", "emptied.")) and ".peers." not in name]
    lines.append(markdown_table(["", "µs"], [[name, spread(figures, name)] for name in others]))
    lines.append(markdown_table(["peer", "µs", "ours", "µs", "times as fast"], peer_rows(figures, timed)))
    errors = [key for key in figures if key.startswith("error.")]
    lines.append(markdown_table(["error", "mm"], [[key, f"{figures[key]:.3g}"] for key in errors]))
    return "\n".join(lines + [f"missing: {name}: {reason}" for name, reason in figures["missing"].items()])


def peer_rows(figures: Mapping[str, object], timed: Sequence[str]) -> list[list[str]]:
    """Of every peer, warm, cold and with emptied caches: its time, ours that were measured alike, and their ratio."""
    rows = []
    for name in (name for name in timed if "peers." in name):
        before, kind = name[: name.index("peers.")], name.split(".")[-2]
        stages = ["networks"] if kind == "networks" else ["skinning", "normals"]
        for level in compared_levels():
            ours = f"{before}{'int8' if name.endswith('int8') else 'fp32'}.{level}."
            if all(ours + stage in timed for stage in stages):
                took = sum(figures[f"{ours}{stage}.us.p50"] for stage in stages)
                times = figures[f"{name}.us.p50"] / took
                rows.append([name, spread(figures, name), ours + " + ".join(stages), f"{took:.1f}", f"{times:.2f}"])
    return rows


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
