"""Figures of a benchmark as flat JSON keys and as tables. docs/benchmark.md says what every key means."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from physkin_bench.measurement import BYTES_A_WEIGHT, STAGES, CaseResult
from physkin_bench.timing import Timing
from physkin_core.runtime.native_evaluator import PRECISIONS, supported_instruction_sets

__all__ = ["case_keys", "case_tables", "machine_keys"]

BLOCK = 16
"""Vertices that share one union of garment nodes."""
MULTIPLY_ADDS_A_VERTEX = 36
"""That apply a blended matrix to a position and its cofactors to a normal; blending costs 12 a garment node."""


def machine_keys() -> dict[str, object]:
    """What ran the benchmark: processor, caches, load, Python and NumPy."""
    return {
        "machine.cpu": _processor(),
        "machine.cores": os.cpu_count(),
        "machine.caches": _caches(),
        "machine.instruction_sets": supported_instruction_sets(),
        "machine.load_average": list(os.getloadavg()),
        "machine.system": platform.platform(),
        "versions.python": platform.python_version(),
        "versions.numpy": np.__version__,
    }


def case_keys(result: CaseResult) -> dict[str, object]:
    """Flat keys of one case; a ratio whose peer is missing is None."""
    widest = supported_instruction_sets()[-1]
    keys: dict[str, object] = {"model": result.case.name, "vertices": len(result.case.bound.vertices)}
    keys |= {"network_weights": result.weight_count, "activation": result.case.bound.activation}
    keys["garment_nodes_a_block"] = result.skinning_terms / _blocks(result)
    for (precision, level, stage), timing in result.native.items():
        keys |= _timing_keys(f"{precision}.{level}.{stage}", timing)
        if (precision, level) == ("fp32", widest):
            keys |= _timing_keys(stage, timing)
    for (precision, count), timing in result.batches.items():
        keys |= _timing_keys(f"batch.{precision}.{count}", timing)
    for precision, timing in result.singles.items():
        keys |= _timing_keys(f"singles.{precision}", timing)
    for level, timing in result.face_normals.items():
        keys |= _timing_keys(f"{level}.face_normals", timing)
    for kind, timings in (("networks", result.network_peers), ("skinning", result.skinning_peers)):
        for name, timing in timings.items():
            keys |= _timing_keys(f"peers.{kind}.{name}", timing)
    for name, timing in result.cold.items():
        keys |= _timing_keys(f"cold.{name}", timing)
    for precision, errors in result.errors.items():
        keys |= {f"error.{precision}.{figure}": value for figure, value in errors.items()}
    return keys | _ratio_keys(result, widest) | _floor_keys(result, widest) | {"missing": dict(result.missing)}


def _timing_keys(name: str, timing: Timing) -> dict[str, float]:
    return {f"{name}.us.{figure}": value for figure, value in asdict(timing).items() if figure != "count"}


def _ratio_keys(result: CaseResult, level: str) -> dict[str, float | None]:
    """How many times longer the peer takes, by medians."""
    peers = {name: timing.p50 for name, timing in result.network_peers.items()}
    best_skinning = min((timing.p50 for timing in result.skinning_peers.values()), default=None)

    def ratio(precision: str, stage: str, *theirs: float | None) -> float | None:
        return None if None in theirs else sum(theirs) / result.native[precision, level, stage].p50

    litert_fp32, litert_int8 = peers.get("litert_fp32"), peers.get("litert_int8")
    return {
        "ratio.networks_fp32_vs_litert_fp32": ratio("fp32", "networks", litert_fp32),
        "ratio.networks_bf16_vs_litert_fp32": ratio("bf16", "networks", litert_fp32),
        "ratio.networks_int8_vs_litert_int8": ratio("int8", "networks", litert_int8),
        "ratio.skinning_vs_best_peer": ratio("fp32", "skinning", best_skinning),
        "ratio.frame_bf16": ratio("bf16", "frame", litert_fp32, best_skinning),
        "ratio.frame_int8": ratio("int8", "frame", litert_int8, best_skinning),
    }


def _floor_keys(result: CaseResult, level: str) -> dict[str, float]:
    rates = {name: result.amounts[name] / result.probes[name].p50 for name in ("fma", "l2", "l3", "memory")}
    keys = {
        "floor.fma.gmacs": rates["fma"] / 1e3,
        "floor.l2.gbs": rates["l2"] / 1e3,
        "floor.l3.gbs": rates["l3"] / 1e3,
        "floor.memory.gbs": rates["memory"] / 1e3,
    }
    for precision in BYTES_A_WEIGHT:
        floor = result.probes[f"read_{precision}"].p50
        if precision != "int8":
            floor = max(floor, result.weight_count / rates["fma"])
        keys[f"floor.networks_{precision}.us"] = floor
        keys[f"floor.networks_{precision}.share"] = floor / result.native[precision, level, "networks"].p50
    keys["floor.networks.share"] = keys["floor.networks_fp32.share"]
    multiply_adds = BLOCK * (12 * result.skinning_terms + MULTIPLY_ADDS_A_VERTEX * _blocks(result))
    keys["floor.skinning.us"] = multiply_adds / rates["fma"]
    keys["floor.skinning.share"] = keys["floor.skinning.us"] / result.native["fp32", level, "skinning"].p50
    return keys


def _blocks(result: CaseResult) -> int:
    return -(-len(result.case.bound.vertices) // BLOCK)


def case_tables(result: CaseResult, keys: Mapping[str, object]) -> str:
    """The figures of one case as Markdown tables, microseconds."""
    widest = supported_instruction_sets()[-1]
    lines = [f"## {result.case.name}: {keys['vertices']} vertices, {keys['network_weights']} network weights", ""]
    rows = []
    for precision in PRECISIONS:
        for level in reversed(supported_instruction_sets()):
            rows.append([precision, level, *(_spread(result.native[precision, level, stage]) for stage in STAGES)])
    lines += _table(["us: p50 (min, p99)", "instructions", *STAGES], rows)
    sizes = sorted({count for _, count in result.batches})
    rows = [
        [name, *(_spread(result.batches[name, count]) for count in sizes), _spread(result.singles[name])]
        for name in PRECISIONS
    ]
    lines += _table(["us a body, frames together", *map(str, sizes), f"{max(sizes)} one by one"], rows)
    if result.face_normals:
        rows = [[name, _spread(timing)] for name, timing in result.face_normals.items()]
        lines += _table(["normals from faces", "us"], rows)
    timings = {f"native {name}": result.native[name, widest, "networks"] for name in PRECISIONS} | result.network_peers
    lines += _table(["networks, same graph", "us"], [[name, _spread(timings[name])] for name in _by_median(timings)])
    timings = {"native": result.native["fp32", widest, "skinning"]} | result.skinning_peers
    lines += _table(["skinning and normals", "us"], [[name, _spread(timings[name])] for name in _by_median(timings)])
    lines += _table(["caches emptied before every call", "us"], [[k, _spread(v)] for k, v in result.cold.items()])
    rows = [[precision, *(f"{value:.2g}" for value in errors.values())] for precision, errors in result.errors.items()]
    lines += _table(["against float64", *result.errors["fp32"]], rows)
    chosen = [(key, value) for key, value in keys.items() if key.startswith(("ratio.", "floor."))]
    lines += _table(["ratio or floor", ""], [[k, "peer missing" if v is None else f"{v:.3g}"] for k, v in chosen])
    lines += [f"missing: {name}: {reason}" for name, reason in result.missing.items()]
    return "\n".join(lines)


def _by_median(timings: Mapping[str, Timing]) -> list[str]:
    return sorted(timings, key=lambda name: timings[name].p50)


def _spread(timing: Timing) -> str:
    return f"{timing.p50:.1f} ({timing.min:.1f}, {timing.p99:.1f})"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [_row(header), _row(["---"] * len(header)), *map(_row, rows), ""]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _caches() -> dict[str, str]:
    caches = {}
    for index in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
        try:
            level, kind, size = ((index / name).read_text().strip() for name in ("level", "type", "size"))
        except OSError:
            continue
        caches[f"L{level} {kind.lower()}"] = size
    return caches
