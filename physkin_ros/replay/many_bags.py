"""All bags of a folder replayed, one after the other or several at once, with one page over all.

What is written of a bag lies in a folder of its own; one that is finished with the same settings is not done again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import shutil
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
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
NOT_SETTINGS = (*ONE_BAG, "bag", "output", "processes")

Replayed = Callable[[argparse.Namespace], int]


def holds_bags(path: Path) -> bool:
    """Whether a folder is no bag itself, but one of bags."""
    return path.is_dir() and not (path / METADATA).exists()


def bags_in(folder: Path) -> list[Path]:
    """The bags directly in a folder, by name. Raises BagError when there are none."""
    found = [path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES or (path / METADATA).exists()]
    if not found:
        raise BagError(f"{folder} is no bag and holds none; allowed: folders with {METADATA}, {' and '.join(SUFFIXES)}")
    return found


def replay_all(options: argparse.Namespace, replay_one: Replayed) -> int:
    """Replay every bag of the folder `options.bag` into `options.output`, and write the page over all.

    replay_one: of one bag, a function of a module. A bag that cannot be replayed is a row of the page with the reason.
    Returns 0, or 1 when there is one. Raises BagError for options that are for one bag, or no output folder.
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
    bags = {bag: output / bag.name for bag in bags_in(options.bag)}
    output.mkdir(parents=True, exist_ok=True)
    failed: dict[Path, str] = {}
    to_do = [bag for bag, folder in bags.items() if not _finished(folder, _settings(options, bag))]
    print(f"{len(bags)} bags, {len(bags) - len(to_do)} of them finished")
    watch = progress_line(f"replaying {len(to_do)} bags")
    with closing(_replayed(options, to_do, bags, replay_one)) as replayed:
        for done, (bag, reason) in enumerate(replayed, 1):
            if reason:
                failed[bag] = reason
            print(f"{done} of {len(to_do)}: {bag.name}: {reason or 'replayed'}")
            _write_page(output, bags, failed)
            watch(done / len(to_do))
    _write_page(output, bags, failed)
    print(f"wrote {output / OVERVIEW}")
    return 1 if failed else 0


def _replayed(
    options: argparse.Namespace, to_do: Sequence[Path], bags: Mapping[Path, Path], replay_one: Replayed
) -> Iterator[tuple[Path, str]]:
    """Each bag with why it could not be replayed, as they are done."""
    jobs = {bag: (replay_one, _options_of(options, bag, bags[bag]), _settings(options, bag)) for bag in to_do}
    if (options.processes or 1) == 1:
        yield from ((bag, _replay_into(*job)) for bag, job in jobs.items())
        return
    with ProcessPoolExecutor(options.processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        interrupt = signal.signal(signal.SIGINT, signal.SIG_IGN)  # processes inherit that: they are ended from here
        futures = {pool.submit(_replay_into, *job): bag for bag, job in jobs.items()}
        signal.signal(signal.SIGINT, interrupt)
        try:
            for future in as_completed(futures):
                yield futures[future], _reason(future)
        except BaseException:  # an interrupt, too: left alone, the pool would replay all bags before it ends
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def _reason(future: Future) -> str:
    try:
        return future.result()
    except BrokenProcessPool:
        return "a process was lost; the same command goes on"


def _options_of(options: argparse.Namespace, bag: Path, folder: Path) -> argparse.Namespace:
    written = {"output": folder / CLOUDS, "json": folder / FIGURES, "report": folder / REPORT}
    return argparse.Namespace(**(vars(options) | {"bag": bag} | written))


def _replay_into(replay_one: Replayed, options: argparse.Namespace, settings: dict) -> str:
    """Replay a bag into its folder; its settings are written last. Returns why it could not be."""
    folder = options.output.parent
    folder.mkdir(exist_ok=True)
    for clouds in (folder / CLOUDS, *folder.glob(f".{CLOUDS}-*")):  # the latter of a process that was ended
        shutil.rmtree(clouds, ignore_errors=True)
    for name in (SETTINGS, FIGURES, REPORT):
        (folder / name).unlink(missing_ok=True)
    try:
        replay_one(options)
    except (ValueError, OSError) as error:
        return str(error)
    (folder / SETTINGS).write_text(json.dumps(settings))
    return ""


def _settings(options: argparse.Namespace, bag: Path) -> dict:
    """What the clouds depend on, as far as can be told without reading the bag: its files' sizes and times, options."""
    files = sorted(bag.rglob("*")) if bag.is_dir() else [bag]
    stamps = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in files]
    chosen = {name: str(value) for name, value in vars(options).items() if name not in NOT_SETTINGS}
    return {"bag": stamps, "options": chosen}


def _finished(folder: Path, settings: dict) -> bool:
    try:
        return json.loads((folder / SETTINGS).read_text()) == settings
    except (OSError, ValueError):
        return False


def _write_page(output: Path, bags: Mapping[Path, Path], failed: Mapping[Path, str]) -> None:
    rows = []
    for bag, folder in bags.items():
        done = (folder / SETTINGS).exists()
        figures = json.loads((folder / FIGURES).read_text(encoding="utf-8")) if done else None
        rows.append((bag.name, f"{folder.name}/{REPORT}", figures, failed.get(bag, "")))
    write_overview(output / OVERVIEW, rows)
