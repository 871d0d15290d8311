"""All bags of a folder replayed, one after the other or on a Ray cluster, with one page over all.

What is written of a bag lies in a folder of its own; one that is finished with the same settings is not done again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from physkin_core.cluster.cluster import FolderRow, Outcome, do_folder_rows
from physkin_core.motion.bag_reader import BagError
from physkin_core.motion.loading import BAG_SUFFIXES
from physkin_ros.replay.report import overview

__all__ = ["holds_bags", "replay_all"]

METADATA = "metadata.yaml"
FIGURES, REPORT, CLOUDS = "figures.json", "report.html", "clouds"
OVERVIEW = "replay.html"
ONE_BAG = ("json", "report", "baseline")
"""Options for one bag; of many, figures and reports are always written."""


def holds_bags(path: Path) -> bool:
    """Whether a folder is no bag itself, but one of bags."""
    return path.is_dir() and not (path / METADATA).exists()


def replay_all(options: argparse.Namespace, replay_one: Callable[[argparse.Namespace], int]) -> int:
    """Replay every bag of the folder `options.bag` into `options.output`, and write the page over all.

    A bag that cannot be replayed is a row of the page with the reason. Returns 0, or 1 when there is one. Raises
    BagError for options that are for one bag, no output folder, or where there are no bags directly in the folder.
    """
    for name in ONE_BAG:
        if getattr(options, name) is not None:
            raise BagError(f"--{name} is for a single bag; for a folder of bags, --output gets figures and reports")
    output: Path | None = options.output
    if output is None:
        raise BagError(f"{options.bag} is a folder of bags: give --output FOLDER for the results")
    if output.resolve() == options.bag.resolve():
        raise BagError(f"--output {output} is the folder of the bags itself; choose another")
    inside = sorted(options.bag.iterdir())
    bags = [path for path in inside if path.suffix in BAG_SUFFIXES or (path / METADATA).exists()]
    rows = [FolderRow(bag.name, bag, _settings(options, bag)) for bag in bags]
    if not rows:
        allowed = f"folders with {METADATA}, {' and '.join(BAG_SUFFIXES)}"
        raise BagError(f"{options.bag} is no bag and holds none; allowed: {allowed}")
    where = {"address": options.address, "here": options.address is None}
    work, body = partial(_replay_into, options, replay_one), partial(_overview, output, rows)
    return do_folder_rows(rows, work, output / OVERVIEW, body, called="bags", **where)


def _replay_into(options: argparse.Namespace, replay_one: Callable, row: FolderRow, folder: Path) -> dict:
    """Replay a bag into its folder."""
    written = {"output": folder / CLOUDS, "json": folder / FIGURES, "report": folder / REPORT}
    replay_one(argparse.Namespace(**(vars(options) | {"bag": row.order} | written)))
    return {}


def _settings(options: argparse.Namespace, bag: Path) -> dict:
    """What the clouds depend on, as far as can be told without reading the bag: its files' sizes and times, options."""
    files = sorted(bag.rglob("*")) if bag.is_dir() else [bag]
    stamps = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in files]
    left_out = (*ONE_BAG, "bag", "output", "address")
    return {
        "bag": stamps,
        "options": {name: str(value) for name, value in vars(options).items() if name not in left_out},
    }


def _overview(output: Path, rows: Sequence[FolderRow], outcomes: Mapping[str, Outcome], refresh: int) -> str:
    figures = {name: output / name / FIGURES for name, outcome in outcomes.items() if not outcome.reason}
    read = {name: json.loads(path.read_text(encoding="utf-8")) for name, path in figures.items()}
    return overview([(row.name, f"{row.name}/{REPORT}", read.get(row.name)) for row in rows])
