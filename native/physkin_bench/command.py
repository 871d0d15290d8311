"""Command line of `physkin bench`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from physkin_bench.cases import model_case, paper_case
from physkin_bench.measurement import measure_case
from physkin_bench.network_peers import NETWORK_PEERS
from physkin_bench.peers import Peer, installed_versions
from physkin_bench.report import case_keys, case_tables, machine_keys
from physkin_bench.skinning_peers import SKINNING_PEERS

__all__ = ["main"]

PAPER_ACTIVATIONS = ("silu", "relu")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark, print Markdown tables, write the keys of docs/benchmark.md if asked to.

    Raises ValueError for a model or a peer that does not exist, or numbers of rounds below 1.
    """
    options = _parser().parse_args(argv)
    if min(options.rounds, options.cold_rounds) < 1:
        raise ValueError(f"rounds must be 1 or more, got {options.rounds} and {options.cold_rounds} with cold caches")
    network_peers, skinning_peers = (_chosen(peers, options.peers) for peers in (NETWORK_PEERS, SKINNING_PEERS))
    keys = machine_keys()
    used = (*network_peers, *skinning_peers)
    keys |= {f"versions.{name}": version for name, version in installed_versions(used).items()}
    print("\n".join(f"{key}: {value}" for key, value in keys.items()) + "\n")
    cases = [("", lambda: model_case(options.model))]
    if not options.no_paper:
        cases += [(f"paper_{kind}.", lambda kind=kind: paper_case(kind)) for kind in PAPER_ACTIVATIONS]
    for prefix, make in cases:
        result = measure_case(
            make(),
            rounds=options.rounds,
            cold_rounds=options.cold_rounds,
            network_peers=network_peers,
            skinning_peers=skinning_peers,
        )
        figures = case_keys(result)
        keys |= {prefix + key: value for key, value in figures.items()}
        print(case_tables(result, figures) + "\n", flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps(keys, indent=1) + "\n")
        print(f"wrote {options.json}", file=sys.stderr)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="physkin bench", description="Time the native evaluator and its peers.")
    parser.add_argument("model", nargs="?", default="tshirt", help="garment model (default %(default)s)")
    parser.add_argument("--rounds", type=int, default=100, metavar="N", help="turns of 5 calls (default %(default)s)")
    parser.add_argument(
        "--cold-rounds", type=int, default=30, metavar="N", help="with cold caches (default %(default)s)"
    )
    parser.add_argument("--peers", metavar="NAME,...", help="peers to compare with (default: all; 'none' for none)")
    parser.add_argument("--no-paper", action="store_true", help="leave out the paper's sizes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure to this file")
    return parser


def _chosen(peers: Sequence[Peer], names: str | None) -> tuple[Peer, ...]:
    if names is None:
        return tuple(peers)
    wanted = set(names.split(",")) - {"none"}
    known = {peer.name for peer in (*NETWORK_PEERS, *SKINNING_PEERS)}
    if unknown := sorted(wanted - known):
        raise ValueError(f"no peer {', '.join(unknown)}; known: {', '.join(sorted(known))}")
    return tuple(peer for peer in peers if peer.name in wanted)
