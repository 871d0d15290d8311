"""The figures of a replayed bag, as `--json` writes them, and their comparison with an earlier run's.

docs/replay.md explains every key. Dimensions: `T` clouds, `C` clouds measured against the body.
"""

from __future__ import annotations

import math
import platform
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
from tabulate import tabulate

from physkin_core import Draper
from physkin_core.file_reading import read_bytes, read_json, reading
from physkin_core.motion.bag_reader import BagReader
from physkin_ros.replay.replay import Replay

__all__ = ["LABELS", "SCHEMA", "TOLERANCES", "BaselineError", "describe", "load_baseline", "regressions", "summary"]

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
SPREAD = ("mean", "p50", "p95", "p99", "max")
ROOT = {
    "gravity": "gravity messages",
    "pose": "poses of the root",
    "odometry": "odometry messages",
    "tf": "TF messages",
    "imu": "IMU messages",
}
"""What tells where the root is -> what people read."""
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
MEASURED = (*(name for name in LABELS if name != "jitter_ratio"), "jitter_skinning_mm", "latency_us")
"""What is measured cloud by cloud."""
DECIMALS = 5
"""Of a series."""
COUNTS = (
    *("joint_states", "draped", "rejected", "not_finite", "without_positions", "gravity_messages", "gravity_rejected"),
    *("root_unknown", "names_unknown", "out_of_range_clouds"),
)


class BaselineError(ValueError):
    """A baseline cannot be read, or is of another bag or run in another way."""


def describe(found: Replay, draper: Draper, bag: BagReader, *, contact_every: int) -> dict:
    """Everything `--json` writes. `found` must hold a cloud at least."""
    times = (np.array(found.times_ns) - found.times_ns[0]) / 1e9
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else math.nan
    measured = {name: np.array(found.measured[name]) for name in MEASURED}
    gaps = np.ones(len(times), dtype=bool)  # over which nothing is differenced: the last two steps must be even
    even = (steps > 0) & (steps < LONGEST_STEP * usual)
    gaps[2:] = ~(even[1:] & even[:-1])
    for name in ("jitter_mm", "jitter_skinning_mm"):
        measured[name][gaps] = math.nan
    figures = {name: _spread(measured[name]) for name in LABELS if name in measured}
    jitter, skinning = figures["jitter_mm"]["mean"], _spread(measured["jitter_skinning_mm"])["mean"]
    figures["jitter_skinning_mm"] = {"mean": skinning}
    figures["jitter_ratio"] = {"mean": jitter / skinning if jitter is not None and skinning else None}
    series = {"time_s": times, "contact_time_s": times[list(found.kept)]} | measured
    return {
        "schema": SCHEMA,
        "bag": {
            "name": bag.path.name,
            "topic": bag.topic,
            "gravity_topic": bag.orientation_topic,
            "sha256": found.bag_sha256,
            "duration_s": float(times[-1]),
            "rate_hz": 1 / usual if usual > 0 else None,
        },
        "run": {
            "model": draper.model.name,
            "vertices": draper.vertex_count,
            "avatar": Path(draper.avatar.source).name,
            "orientation": found.orientation,
            "sway": found.sway,
            "fit": draper.fit,
            "at_rest": asdict(draper.at_rest),
            "instruction_set": draper.instruction_set,
            "contact_every": contact_every,
            "machine": platform.machine(),
        },
        "counts": {
            **{name: found.counts[name] for name in COUNTS},
            "contact_clouds": len(found.kept),
            "jitter_clouds": int(np.isfinite(measured["jitter_mm"]).sum()),
        },
        "reasons": _most_frequent_first(found.reasons),
        "out_of_range": _most_frequent_first(found.out_of_range),
        "figures": figures,
        "latency_us": _spread(measured["latency_us"]),
        "clouds_sha256": found.clouds_sha256,
        "series": {name: _rounded(values) for name, values in series.items()},
    }


def load_baseline(path: Path) -> dict:
    """Read what an earlier `--json` wrote. Raises BaselineError."""
    with reading(f"baseline {path}", BaselineError):
        figures = read_json(read_bytes(path))
    if not isinstance(figures, dict) or figures.get("schema") != SCHEMA:
        raise BaselineError(f"{path} is no baseline: it must be what --json wrote, schema {SCHEMA}")
    sections = ("bag", "run", "counts", "figures", "latency_us")
    if broken := [name for name in sections if not isinstance(figures.get(name), dict)]:
        raise BaselineError(f"baseline {path} lacks {', '.join(broken)}")
    return figures


def regressions(figures: Mapping, baseline: Mapping) -> list[str]:
    """What is worse than in the baseline, a sentence each; empty if nothing is.

    Figures may grow by `TOLERANCES`, rejected messages and clouds out of range not at all; a figure that only the
    baseline has counts as worse. Latencies are the machine's and not compared.
    Raises BaselineError when the baseline is of another bag, or measured contact on other clouds.
    """
    for section, key in (("bag", "sha256"), ("run", "contact_every")):
        new, old = figures[section][key], baseline[section].get(key)
        if new != old:
            raise BaselineError(f"the baseline cannot be compared: its {section} {key} is {old}, this one's is {new}")
    grown = {
        f"{name} {kind}": (figures["figures"][name][kind], _number(baseline["figures"], name, kind), *allowed)
        for (name, kind), allowed in TOLERANCES.items()
    }
    for name in ("rejected", "gravity_rejected"):
        grown[name] = figures["counts"][name], _number(baseline["counts"], name), 0, 0
    worse = []
    for name, (new, old, share, margin) in grown.items():
        if old is not None and new is None:
            worse.append(f"{name} is missing; it was {old:.4g}")
        elif old is not None and new > (allowed := old + share * abs(old) + margin):
            worse.append(f"{name} is {new:.4g}; it was {old:.4g}, allowed is {allowed:.4g}")
    return worse


def summary(figures: Mapping, tablefmt: str = "plain") -> str:
    """What came of the bag and the figures, two tables. tablefmt: as of `tabulate`, which escapes for "html"."""
    counts, bag, run = figures["counts"], figures["bag"], figures["run"]
    rate = f", {bag['rate_hz']:.1f} Hz" if bag["rate_hz"] else ""
    facts = {
        "garment": f"{run['model']}, {run['vertices']} vertices, fit {run['fit']:g}, on {run['avatar']}",
        "at rest": f"{run['at_rest']['inside_percent']:.1f} % of the cloth inside the body",
        "joint states": f"{counts['joint_states']} on {bag['topic']}, {bag['duration_s']:.2f} s{rate}",
        "draped / rejected": f"{counts['draped']} / {counts['rejected']}",
        f"{ROOT[run['orientation']]} / rejected": f"{counts['gravity_messages']} / {counts['gravity_rejected']}",
        "instruction set": run["instruction_set"],
    }
    if counts["not_finite"] or counts["without_positions"]:
        facts["positions not finite / missing"] = f"{counts['not_finite']} / {counts['without_positions']}"
    if counts["root_unknown"]:
        facts["draped without knowing where the root is"] = f"{counts['root_unknown']}"
    if counts["out_of_range_clouds"]:
        joints = ", ".join(f"{name} ({count})" for name, count in list(figures["out_of_range"].items())[:6])
        facts["beyond joint limits"] = f"{counts['out_of_range_clouds']} clouds: {joints}"
    reasons = [(f"rejected {count} times", reason) for reason, count in list(figures["reasons"].items())[:5]]
    spreads = {label: figures["figures"][name] for name, label in LABELS.items()}
    spreads["evaluator [µs]"] = figures["latency_us"]
    rows = [[label, *map(spread.get, SPREAD)] for label, spread in spreads.items()]
    tables = [
        tabulate([*facts.items(), *reasons], tablefmt=tablefmt, disable_numparse=True),
        tabulate(rows, ["", *SPREAD], tablefmt=tablefmt, floatfmt=".3f", missingval=""),
    ]
    return "\n\n".join(tables)


def _spread(values: np.ndarray) -> dict[str, float | None]:
    """Over the values that are numbers."""
    values = values[np.isfinite(values)]
    if not len(values):
        return dict.fromkeys(SPREAD)
    p50, p95, p99 = np.percentile(values, (50, 95, 99))
    return dict(zip(SPREAD, map(float, (values.mean(), p50, p95, p99, values.max()))))


def _most_frequent_first(counter: Counter) -> dict[str, int]:
    return dict(sorted(counter.items(), key=lambda item: (-item[1], item[0])))


def _rounded(values: np.ndarray) -> list[float | None]:
    return [None if math.isnan(value) else round(value, DECIMALS) for value in values.tolist()]


def _number(figures: Mapping, *keys: str) -> float | None:
    """Of a baseline, None where it has none."""
    for key in keys:
        figures = figures.get(key) if isinstance(figures, Mapping) else None
    if figures is not None and (isinstance(figures, bool) or not isinstance(figures, (int, float))):
        raise BaselineError(f"the baseline's {' '.join(keys)} is {figures!r}; it must be a number")
    return figures
