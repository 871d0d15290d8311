"""The paper's ablations in one command.

    PYTHONPATH=training:native python -m physkin_studies.ablations --minutes 4 --output DIR

Every row trains for the same time, as a process of its own, on the next device that is free; rows that are finished are
skipped, so that the command can be stopped and given again. In the end (or alone, with `--report-only`, on the machine
whose frame times are wanted) tables, plots and pictures are written to DIR/report.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

from physkin_studies.ablation_rows import ROWS, RowOptions, finished_figures

__all__ = ["main", "run_rows"]

CONFIGS = Path(__file__).parents[1] / "configs"
FIRST = ("supervised",)
"""Rows that take longest, started first."""


def run_rows(
    names: Sequence[str], config: Path, folder: Path, options: RowOptions, *, devices: Sequence[str], each: int = 1
) -> list[str]:
    """Run the rows that are not finished yet, `each` at a time on every device; returns those that failed.

    devices: "cpu", or indices of GPUs as text. Raises ValueError when a finished row had another budget.
    """
    waiting = []
    for name in sorted(names, key=lambda name: name not in FIRST):
        done = finished_figures(folder, name)
        if done is None:
            waiting.append(name)
        elif done["budget_minutes"] != options.minutes:
            raise ValueError(
                f"row {name} in {folder} was trained for {done['budget_minutes']:g} minutes, not {options.minutes:g}; "
                "remove its folder, or take another output folder"
            )
    free: queue.SimpleQueue[str] = queue.SimpleQueue()
    for device in each * list(devices):
        free.put(device)

    def finished(name: str) -> bool:
        device = free.get()
        try:
            return _run(name, config, folder, options, device)
        finally:
            free.put(device)

    with ThreadPoolExecutor(each * len(devices)) as pool:
        good = list(pool.map(finished, waiting))
    return sorted((name for name, went_well in zip(waiting, good) if not went_well), key=list(ROWS).index)


def _run(name: str, config: Path, folder: Path, options: RowOptions, device: str) -> bool:
    """One row in a process that sees one device; whether it finished."""
    own = folder / name
    own.mkdir(parents=True, exist_ok=True)
    environment = dict(os.environ)
    if device != "cpu":
        environment["CUDA_VISIBLE_DEVICES"] = device
    command = [
        *(sys.executable, "-m", "physkin_studies.ablation_rows", name),
        *("--config", str(config), "--output", str(folder), "--options", json.dumps(asdict(options))),
        *("--device", "cpu" if device == "cpu" else "cuda"),
    ]
    began = time.perf_counter()
    print(f"{name}: started on {device}", flush=True)
    with open(own / "log.txt", "w") as log:
        status = subprocess.run(command, env=environment, stdout=log, stderr=subprocess.STDOUT).returncode
    figures = finished_figures(folder, name) if status == 0 else None
    if figures is None:
        lines = (own / "log.txt").read_text().splitlines()
        print(f"{name}: failed with status {status}: {lines[-1] if lines else 'it said nothing'}", flush=True)
        return False
    model = figures["figures"]["model"]
    print(
        f"{name}: {figures['steps']} steps, edge {model['edge_strain_percent']:.2f} %, area "
        f"{model['area_strain_percent']:.2f} %, inside {model['inside_percent']:.3f} %; "
        f"{(time.perf_counter() - began) / 60:.1f} minutes in all",
        flush=True,
    )
    return True


def main(argv: list[str] | None = None) -> int:
    """Command line entry. Returns 0, 1 when a row failed, 2 after an error that the user can mend."""
    parser = argparse.ArgumentParser(prog="python -m physkin_studies.ablations", description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=4.0, help="of training a row (default %(default)s)")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--rows", nargs="+", choices=tuple(ROWS), default=tuple(ROWS), metavar="NAME")
    parser.add_argument("--devices", default="0", help="GPU indices with commas between, or cpu (default %(default)s)")
    parser.add_argument("--rows-per-device", type=int, default=1, help="rows at a time on a device (default 1)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--garment", default="tshirt", help="whose shipped configuration to change (default tshirt)")
    which.add_argument("--config", type=Path, help="another configuration to change")
    parser.add_argument("--bodies", type=int, default=RowOptions.bodies, help="held-out bodies to measure on")
    parser.add_argument("--poses", type=int, default=RowOptions.poses, help="uniform poses of each")
    parser.add_argument("--drapes", type=int, default=RowOptions.drapes, help="to simulate for the supervised row")
    parser.add_argument("--drape-batch", type=int, default=RowOptions.drape_batch, help="simulated at once")
    end = parser.add_mutually_exclusive_group()
    end.add_argument("--report-only", action="store_true", help="train nothing, report on what is finished")
    end.add_argument("--no-report", action="store_true", help="train only")
    arguments = parser.parse_args(argv)
    config = arguments.config or CONFIGS / f"{arguments.garment}.toml"
    devices = arguments.devices.split(",")
    failed: list[str] = []
    try:
        options = RowOptions(
            arguments.minutes, arguments.bodies, arguments.poses, arguments.drapes, arguments.drape_batch
        )
        if not all(device == "cpu" or device.isdigit() for device in devices):
            raise ValueError(f"devices must be GPU indices with commas between, or cpu, got {arguments.devices!r}")
        if arguments.rows_per_device < 1:
            raise ValueError(f"rows per device must be at least 1, got {arguments.rows_per_device}")
        if not config.is_file():
            raise ValueError(f"no training configuration {config}; give one with --config")
        if not arguments.report_only:
            failed = run_rows(
                arguments.rows, config, arguments.output, options, devices=devices, each=arguments.rows_per_device
            )
        if not arguments.no_report:
            from physkin_studies.ablation_report import write_report

            print(f"wrote {write_report(arguments.output)}")
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
