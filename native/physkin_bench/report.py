"""Figures of a benchmark as Markdown tables, and what machine and versions they are of."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from physkin_bench.measurement import STAGES
from physkin_core.runtime.evaluator import PRECISIONS, supported_instruction_sets

__all__ = ["case_tables", "machine_keys"]

PACKAGES = ("physkin", "numpy", "ai-edge-litert", "warp-lang")


def machine_keys() -> dict[str, object]:
    """What ran the benchmark: processor, caches, load, Python and NumPy."""
    info = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.partition(":")[2].strip() for line in info if line.startswith("model name")]
    caches = sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*"))
    versions = {}
    for package in PACKAGES:
        try:
            versions[f"versions.{package}"] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "machine.cpu": names[0] if names else platform.processor() or platform.machine(),
        "machine.cores": os.cpu_count(),
        "machine.caches": [f"L{(c / 'level').read_text().strip()} {(c / 'size').read_text().strip()}" for c in caches],
        "machine.instruction_sets": supported_instruction_sets(),
        "machine.load_average": list(os.getloadavg()),
        "machine.system": platform.platform(),
        "versions.python": platform.python_version(),
        **versions,
    }


def case_tables(figures: Mapping[str, object]) -> str:
    """One case; times are µs, median (fastest, 99th percentile)."""

    def spread(name: str) -> str:
        return "{:.1f} ({:.1f}, {:.1f})".format(*(figures[f"{name}.us.{figure}"] for figure in ("p50", "min", "p99")))

    levels = supported_instruction_sets()[::-1]
    lines = [f"## {figures['model']}: {figures['vertices']} vertices, {figures['network_weights']} network weights", ""]
    rows = [[p, level, *(spread(f"{p}.{level}.{stage}") for stage in STAGES)] for p in PRECISIONS for level in levels]
    lines += _table(["µs: median (fastest, p99)", "instructions", *STAGES], rows)

    timed = [key.removesuffix(".us.p50") for key in figures if key.endswith(".us.p50")]
    others = [name for name in timed if name.split(".")[0] in ("face_normals", "separate_limbs", "cold")]
    lines += _table(["", "µs"], [[name, spread(name)] for name in others])
    rows = []
    for name in (name for name in timed if name.startswith("peers.")):
        ours = f"{'int8' if name.endswith('int8') else 'fp32'}.{levels[0]}.{name.split('.')[1]}"
        rows.append([name, spread(name), ours, f"{figures[f'{name}.us.p50'] / figures[f'{ours}.us.p50']:.2f}"])
    lines += _table(["peer", "µs", "ours", "times as fast"], rows)
    rest = [key for key in figures if key.startswith(("floor.", "error."))]
    lines += _table(["limit or error", ""], [[key, f"{figures[key]:.3g}"] for key in rest])
    return "\n".join(lines + [f"missing: {name}: {reason}" for name, reason in figures["missing"].items()])


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(cells) + " |" for cells in (header, ["---"] * len(header), *rows)] + [""]
