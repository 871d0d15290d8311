"""Figures of a benchmark as Markdown tables."""

from __future__ import annotations

from collections.abc import Mapping

from physkin_bench.measurement import BATCH_SIZES
from physkin_core.bench import markdown_table, spread, stage_table
from physkin_core.runtime.native_evaluator import PRECISIONS, supported_instruction_sets

__all__ = ["case_tables"]


def case_tables(figures: Mapping[str, object]) -> str:
    """One case; times are µs, median (fastest, 99th percentile)."""

    lines = [f"## {figures['model']}: {figures['vertices']} vertices, {figures['network_weights']} network weights", ""]
    lines.append(stage_table(figures))
    rows = [[p, *(spread(figures, f"batch.{p}.{count}") for count in BATCH_SIZES)] for p in PRECISIONS]
    lines.append(markdown_table(["a body, frames together", *map(str, BATCH_SIZES)], rows))

    timed = [key.removesuffix(".us.p50") for key in figures if key.endswith(".us.p50")]
    others = [name for name in timed if name.split(".")[0] in ("face_normals", "separate_limbs", "cold")]
    lines.append(markdown_table(["", "µs"], [[name, spread(figures, name)] for name in others]))
    rows = []
    for name in (name for name in timed if name.startswith("peers.")):
        ours = f"{'int8' if name.endswith('int8') else 'fp32'}.{supported_instruction_sets()[-1]}.{name.split('.')[1]}"
        rows.append([name, spread(figures, name), ours, f"{figures[f'{name}.us.p50'] / figures[f'{ours}.us.p50']:.2f}"])
    lines.append(markdown_table(["peer", "µs", "ours", "times as fast"], rows))
    rest = [key for key in figures if key.startswith(("floor.", "error."))]
    lines.append(markdown_table(["limit or error", ""], [[key, f"{figures[key]:.3g}"] for key in rest]))
    return "\n".join(lines + [f"missing: {name}: {reason}" for name, reason in figures["missing"].items()])
