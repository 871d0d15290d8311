"""The figures of a replayed bag, as `--json` writes them, and their comparison with an earlier run's.

docs/replay.md explains every key. Dimensions: `T` clouds, `C` clouds measured against the body.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from physkin_core import Draper

if TYPE_CHECKING:
    from physkin_ros.replay.bags import BagReader
    from physkin_ros.replay.replay import Replay

__all__ = ["SCHEMA", "TOLERANCES", "BaselineError", "describe", "load_baseline", "regressions", "summary"]

SCHEMA = 1
LONGEST_STEP = 1.5  # times the usual one: a longer step between two clouds is a gap, over which nothing is differenced

TOLERANCES = {
    ("edge_strain_percent", "mean"): (0.02, 0.02),
    ("edge_strain_percent", "max"): (0.05, 0.1),
    ("area_strain_percent", "mean"): (0.02, 0.02),
    ("area_strain_percent", "max"): (0.05, 0.1),
    ("inside_percent", "mean"): (0.05, 0.05),
    ("within_3mm_percent", "mean"): (0.05, 0.2),
    ("max_depth_mm", "max"): (0.10, 0.5),
    ("jitter_mm", "mean"): (0.05, 0.01),
    ("jitter_ratio", "mean"): (0.05, 0.01),
}
"""Figure -> how much larger than the baseline it may be: this share of it plus this much."""
LATENCIES = ("p50", "p99")


class BaselineError(ValueError):
    """A baseline cannot be read, or is of another bag or run in another way."""


def describe(found: Replay, draper: Draper, bag: BagReader, *, contact_every: int) -> dict:
    """Everything `--json` writes. `found` must hold a cloud at least."""
    times = (np.array(found.times_ns) - found.times_ns[0]) / 1e9
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else math.nan
    bend, skinning_bend = _without_gaps(found, steps, usual)
    contact = np.array(found.contact, dtype=np.float64).reshape(-1, 4)
    latency = np.array(found.latency_ns) / 1e3
    jitter, skinning = _mean(1000 * bend), _mean(1000 * skinning_bend)
    figures = {
        "edge_strain_percent": _spread(np.array(found.edge_strain)),
        "area_strain_percent": _spread(np.array(found.area_strain)),
        "inside_percent": _spread(contact[:, 1]),
        "within_3mm_percent": _spread(contact[:, 2]),
        "max_depth_mm": _spread(contact[:, 3]),
        "jitter_mm": _spread(1000 * bend[np.isfinite(bend)]),
        "jitter_skinning_mm": {"mean": skinning},
        "jitter_ratio": {"mean": jitter / skinning if jitter is not None and skinning else None},
    }
    rows = contact[:, 0].astype(int)
    return {
        "schema": SCHEMA,
        "bag": {
            "name": bag.path.name,
            "topic": bag.topic,
            "gravity_topic": bag.gravity_topic,
            "sha256": bag.digest(),
            "duration_s": float(times[-1]),
            "rate_hz": 1 / usual if usual > 0 else None,
        },
        "run": {
            "model": draper.model.name,
            "vertices": draper.vertex_count,
            "avatar": Path(draper.avatar.source).name,
            "backend": draper.backend,
            "instruction_set": draper.instruction_set,
            "contact_every": contact_every,
            "machine": platform.machine(),
        },
        "counts": {
            **{
                name: found.counts[name]
                for name in (
                    "joint_states",
                    "draped",
                    "rejected",
                    "gravity_messages",
                    "gravity_rejected",
                    "names_unknown",
                )
            },
            "contact_clouds": len(contact),
            "jitter_clouds": int(np.isfinite(bend).sum()),
            "out_of_range_clouds": found.out_of_range_clouds,
        },
        "reasons": dict(sorted(found.reasons.items(), key=lambda item: (-item[1], item[0]))),
        "out_of_range": dict(sorted(found.out_of_range.items(), key=lambda item: (-item[1], item[0]))),
        "figures": figures,
        "latency_us": _spread(latency),
        "clouds_sha256": found.clouds_sha256,
        "series": {
            "time_s": _list(times, 6),
            "edge_strain_percent": _list(np.array(found.edge_strain), 4),
            "area_strain_percent": _list(np.array(found.area_strain), 4),
            "jitter_mm": _list(1000 * bend, 5),
            "jitter_skinning_mm": _list(1000 * skinning_bend, 5),
            "latency_us": _list(latency, 1),
            "contact_time_s": _list(times[rows], 6),
            "inside_percent": _list(contact[:, 1], 4),
            "within_3mm_percent": _list(contact[:, 2], 4),
            "max_depth_mm": _list(contact[:, 3], 4),
        },
    }


def load_baseline(path: Path) -> dict:
    """Read what an earlier `--json` wrote. Raises BaselineError."""
    try:
        figures = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BaselineError(f"cannot read baseline {path}: {error}") from error
    if not isinstance(figures, dict) or figures.get("schema") != SCHEMA:
        raise BaselineError(f"{path} is no baseline: it must be what --json wrote, schema {SCHEMA}")
    sections = ("bag", "run", "counts", "figures", "latency_us")
    if broken := [name for name in sections if not isinstance(figures.get(name), dict)]:
        raise BaselineError(f"baseline {path} lacks {', '.join(broken)}")
    return figures


def regressions(figures: Mapping, baseline: Mapping, *, latency_percent: float | None = None) -> list[str]:
    """What is worse than in the baseline, a sentence each; empty if nothing is.

    Figures may grow by `TOLERANCES`, rejected messages and clouds out of range not at all; a figure that only the
    baseline has counts as worse. latency_percent: by how much latencies may grow; None: they are not compared.
    Raises BaselineError when the baseline is of another bag, or measured contact on other clouds.
    """
    for section, key in (("bag", "sha256"), ("run", "contact_every")):
        new, old = figures[section][key], baseline[section].get(key)
        if new != old:
            raise BaselineError(f"the baseline cannot be compared: its {section} {key} is {old}, this one's is {new}")
    worse = []
    for (name, kind), (share, margin) in TOLERANCES.items():
        new, old = figures["figures"][name][kind], _number(baseline["figures"], name, kind)
        worse += _grown(f"{name} {kind}", new, old, share, margin)
    for name in ("rejected", "gravity_rejected"):
        worse += _grown(name, figures["counts"][name], _number(baseline, "counts", name), 0, 0)
    if latency_percent is not None:
        for kind in LATENCIES:
            old = _number(baseline, "latency_us", kind)
            worse += _grown(f"latency_us {kind}", figures["latency_us"][kind], old, latency_percent / 100, 0)
    return worse


def summary(figures: Mapping) -> str:
    """The figures in a few lines for a terminal."""
    counts, run, latency = figures["counts"], figures["run"], figures["latency_us"]
    rows = {
        "garment": f"{run['model']}, {run['vertices']} vertices, on {run['avatar']}",
        "joint states": f"{counts['joint_states']} in {figures['bag']['duration_s']:.2f} s",
        "draped / rejected": f"{counts['draped']} / {counts['rejected']}",
        "gravity messages / rejected": f"{counts['gravity_messages']} / {counts['gravity_rejected']}",
        "clouds out of training range": f"{counts['out_of_range_clouds']}",
    }
    for name, label in LABELS.items():
        spread = figures["figures"][name]
        if spread["mean"] is not None:
            tail = f", p95 {spread['p95']:.3f}, max {spread['max']:.3f}" if "p95" in spread else ""
            rows[label] = f"mean {spread['mean']:.3f}{tail}"
    rows["evaluator [us]"] = f"p50 {latency['p50']:.1f}, p99 {latency['p99']:.1f} ({run['instruction_set']})"
    for reason, count in list(figures["reasons"].items())[:5]:
        rows[f"rejected {count} times"] = reason
    width = max(map(len, rows))
    return "\n".join(f"  {name:<{width}}  {value}" for name, value in rows.items())


LABELS = {
    "edge_strain_percent": "edge strain [%]",
    "area_strain_percent": "area strain [%]",
    "inside_percent": "vertices inside the body [%]",
    "within_3mm_percent": "vertices within 3 mm [%]",
    "max_depth_mm": "deepest penetration [mm]",
    "jitter_mm": "jitter [mm]",
    "jitter_ratio": "jitter / plain skinning's",
}
"""Figure -> what people read."""


def _without_gaps(found: Replay, steps: np.ndarray, usual: float) -> tuple[np.ndarray, np.ndarray]:
    """Second differences (T,) [m] of model and plain skinning, NaN where the three clouds are not evenly spaced."""
    even = (steps > 0) & (steps < LONGEST_STEP * usual)
    usable = np.zeros(len(found.frames), dtype=bool)
    usable[2:] = even[1:] & even[:-1]
    bends = np.array(found.bend), np.array(found.skinning_bend)
    return tuple(np.where(usable, bend, np.nan) for bend in bends)


def _spread(values: np.ndarray) -> dict[str, float | None]:
    if not len(values):
        return dict.fromkeys(("mean", "p50", "p95", "p99", "max"))
    p50, p95, p99 = np.percentile(values, (50, 95, 99))
    figures = {"mean": values.mean(), "p50": p50, "p95": p95, "p99": p99, "max": values.max()}
    return {name: float(value) for name, value in figures.items()}


def _mean(values: np.ndarray) -> float | None:
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else None


def _list(values: np.ndarray, decimals: int) -> list[float | None]:
    return [None if math.isnan(value) else round(value, decimals) for value in values.tolist()]


def _number(figures: Mapping, *keys: str) -> float | None:
    for key in keys:
        figures = figures.get(key) if isinstance(figures, Mapping) else None
    if figures is not None and (isinstance(figures, bool) or not isinstance(figures, (int, float))):
        raise BaselineError(f"the baseline's {' '.join(keys)} is {figures!r}; it must be a number")
    return figures


def _grown(name: str, new: float | None, old: float | None, share: float, margin: float) -> list[str]:
    if old is None:
        return []
    if new is None:
        return [f"{name} is missing; it was {old:.4g}"]
    allowed = old + share * abs(old) + margin
    return [f"{name} is {new:.4g}; it was {old:.4g}, allowed is {allowed:.4g}"] if new > allowed else []
