"""Command line of `physkin bench`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from physkin_bench.cases import model_case, paper_case
from physkin_bench.measurement import measure_case
from physkin_bench.report import case_tables, machine_keys
from physkin_core.fit_option import add_fit_option

__all__ = ["command_parser", "main"]


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin bench`."""
    parser = argparse.ArgumentParser(prog="physkin bench", description="Time the native evaluator and its peers.")
    parser.add_argument("model", nargs="?", default="tshirt", help="garment model (default %(default)s)")
    add_fit_option(parser)
    parser.add_argument("--rounds", type=int, default=100, metavar="N", help="turns of 5 calls (default %(default)s)")
    parser.add_argument(
        "--cold-rounds", type=int, default=30, metavar="N", help="with cold caches (default %(default)s)"
    )
    parser.add_argument("--no-peers", action="store_true", help="leave out other engines")
    parser.add_argument("--no-paper", action="store_true", help="leave out the paper's sizes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure to this file")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the benchmark, print Markdown tables, write the keys of docs/notebook/benchmark.md if asked to.

    Raises ValueError for a model that does not exist, or numbers of rounds below 1.
    """
    options = command_parser().parse_args(argv)
    if min(options.rounds, options.cold_rounds) < 1:
        raise ValueError(f"rounds must be 1 or more, got {options.rounds} and {options.cold_rounds} with cold caches")
    keys = machine_keys()
    print("\n".join(f"{key}: {value}" for key, value in keys.items()) + "\n")
    cases = [("", lambda: model_case(options.model, fit=options.fit))]
    cases += [] if options.no_paper else [("paper.", paper_case)]
    for prefix, make in cases:
        figures = measure_case(
            make(), rounds=options.rounds, cold_rounds=options.cold_rounds, peers=not options.no_peers
        )
        keys |= {prefix + key: value for key, value in figures.items()}
        print(case_tables(figures) + "\n", flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps(keys, indent=1) + "\n")
        print(f"wrote {options.json}", file=sys.stderr)
    return 0
