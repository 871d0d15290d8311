"""`make bench`: `PYTHONPATH=native python -m physkin_bench [MODEL]`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from physkin_bench.cases import model_case, paper_case
from physkin_bench.measurement import measure_case
from physkin_bench.report import case_tables
from physkin_core import bench

__all__ = ["main"]

PACKAGES = ("physkin", "numpy", "ai-edge-litert", "warp-lang")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark, print Markdown tables, write the keys of docs/notebook/benchmark.md if asked to."""
    parser = bench.command_parser()
    parser.prog = "python -m physkin_bench"
    parser.add_argument(
        "--cold-rounds", type=int, default=30, metavar="N", help="with cold caches (default %(default)s)"
    )
    parser.add_argument("--no-peers", action="store_true", help="leave out other engines")
    parser.add_argument("--no-paper", action="store_true", help="leave out the paper's sizes")
    options = parser.parse_args(argv)
    if min(options.rounds, options.cold_rounds) < 1:
        parser.error(f"rounds must be 1 or more, got {options.rounds} and {options.cold_rounds} with cold caches")
    keys = bench.machine_keys(*PACKAGES)
    print("\n".join(f"{key}: {value}" for key, value in keys.items()) + "\n")
    cases = [("", lambda: model_case(options.model, fit=options.fit))]
    cases += [] if options.no_paper else [("paper.", paper_case)]
    for prefix, make in cases:
        figures = measure_case(
            make(), rounds=options.rounds, cold_rounds=options.cold_rounds, peers=not options.no_peers
        )
        keys |= {prefix + key: value for key, value in figures.items()}
        print(case_tables(figures) + "\n", flush=True)
    bench.finish(options.json, keys)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
