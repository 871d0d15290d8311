"""All bags of a folder replayed, one after the other, with one page over all.

What is written of a bag lies in a folder of its own; one that is finished with the same settings is not done again.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from physkin_core.motion.bag_reader import BagError
from physkin_core.progress import progress_line
from physkin_ros.replay.report import write_overview

__all__ = ["bags_in", "holds_bags", "replay_all"]

METADATA = "metadata.yaml"
SUFFIXES = (".mcap", ".db3")
SETTINGS, FIGURES, REPORT, CLOUDS = "settings.json", "figures.json", "report.html", "clouds"
OVERVIEW = "replay.html"
ONE_BAG = ("json", "report", "baseline")
"""Options for one bag; of many, figures and reports are always written."""


def holds_bags(path: Path) -> bool:
    """Whether a folder is no bag itself, but one of bags."""
    return path.is_dir() and not (path / METADATA).exists()


def bags_in(folder: Path) -> list[Path]:
    """The bags directly in a folder, by name. Raises BagError when there are none."""
    found = [path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES or (path / METADATA).exists()]
    if not found:
        raise BagError(f"{folder} is no bag and holds none; allowed: folders with {METADATA}, {' and '.join(SUFFIXES)}")
    return found


def replay_all(options: argparse.Namespace, replay_one: Callable[[argparse.Namespace], int]) -> int:
    """Replay every bag of the folder `options.bag` into `options.output`, and write the page over all.

    A bag that cannot be replayed is a row of the page with the reason. Returns 0, or 1 when there is one. Raises
    BagError for options that are for one bag, or no output folder.
    """
    for name in ONE_BAG:
        if getattr(options, name) is not None:
            raise BagError(f"--{name} is for a single bag; for a folder of bags, --output gets figures and reports")
    output: Path | None = options.output
    if output is None:
        raise BagError(f"{options.bag} is a folder of bags: give --output FOLDER for the results")
    if output.exists() and not output.is_dir():
        raise BagError(f"--output {output} is a file; for a folder of bags a folder is needed")
    if output.resolve() == options.bag.resolve():
        raise BagError(f"--output {output} is the folder of the bags itself; choose another")
    bags = bags_in(options.bag)
    output.mkdir(parents=True, exist_ok=True)
    failed: dict[str, str] = {}
    to_do = [bag for bag in bags if _settings_of(output / bag.name) != _settings(options, bag)]
    print(f"{len(bags)} bags, {len(bags) - len(to_do)} of them finished")
    watch = progress_line(f"replaying {len(to_do)} bags")
    for done, bag in enumerate(to_do, 1):
        if reason := _replay_into(output / bag.name, options, bag, replay_one):
            failed[bag.name] = reason
        print(f"{done} of {len(to_do)}: {bag.name}: {reason or 'replayed'}")
        _write_page(output, bags, failed)
        watch(done / len(to_do))
    _write_page(output, bags, failed)
    print(f"wrote {output / OVERVIEW}")
    return 1 if failed else 0


def _replay_into(folder: Path, options: argparse.Namespace, bag: Path, replay_one: Callable) -> str:
    """Replay a bag into its folder; its settings are written last. Returns why it could not be."""
    folder.mkdir(exist_ok=True)
    for clouds in (folder / CLOUDS, *folder.glob(f".{CLOUDS}-*")):  # the latter of a run that was ended
        shutil.rmtree(clouds, ignore_errors=True)
    for name in (SETTINGS, FIGURES, REPORT):
        (folder / name).unlink(missing_ok=True)
    written = {"output": folder / CLOUDS, "json": folder / FIGURES, "report": folder / REPORT}
    try:
        replay_one(argparse.Namespace(**(vars(options) | {"bag": bag} | written)))
    except (ValueError, OSError) as error:
        return str(error)
    (folder / SETTINGS).write_text(json.dumps(_settings(options, bag)))
    return ""


def _settings(options: argparse.Namespace, bag: Path) -> dict:
    """What the clouds depend on, as far as can be told without reading the bag: its files' sizes and times, options."""
    files = sorted(bag.rglob("*")) if bag.is_dir() else [bag]
    stamps = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in files]
    chosen = {name: str(value) for name, value in vars(options).items() if name not in (*ONE_BAG, "bag", "output")}
    return {"bag": stamps, "options": chosen}


def _settings_of(folder: Path) -> dict | None:
    """Those of what a folder holds, None where it is not finished."""
    try:
        return json.loads((folder / SETTINGS).read_text())
    except (OSError, ValueError):
        return None


def _write_page(output: Path, bags: list[Path], failed: Mapping[str, str]) -> None:
    rows = []
    for bag in bags:
        folder = output / bag.name
        done = (folder / SETTINGS).exists()
        figures = json.loads((folder / FIGURES).read_text(encoding="utf-8")) if done else None
        rows.append((bag.name, f"{folder.name}/{REPORT}", figures, failed.get(bag.name, "")))
    write_overview(output / OVERVIEW, rows)
