"""The paper's ablations in one command.

    PYTHONPATH=training:native python -m physkin_studies.ablations --minutes 4 --output DIR

Every row trains for the same time, as a process of its own, on the next device that is free; rows that are finished are
skipped, so that the command can be stopped and given again. `--report`, on the machine whose frame times are wanted,
trains nothing and writes tables, plots and pictures of what is finished to DIR/report.
"""

from __future__ import annotations

import argparse
import math
import os
import queue
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from physkin_studies.ablation_rows import ROWS, finished_figures

__all__ = ["main", "run_rows"]

FIRST = ("supervised",)
"""Rows that take longest, started first."""


def run_rows(names: Sequence[str], folder: Path, minutes: float, *, devices: Sequence[str]) -> list[str]:
    """Run the rows that are not finished yet, one at a time on every device; returns those that failed.

    devices: "cpu", or indices of GPUs as text; one that comes twice runs two rows at a time. Raises ValueError when a
    finished row had another budget.
    """
    waiting = []
    for name in sorted(names, key=lambda name: name not in FIRST):
        done = finished_figures(folder, name)
        if done is None:
            waiting.append(name)
        elif done["budget_minutes"] != minutes:
            raise ValueError(
                f"row {name} in {folder} was trained for {done['budget_minutes']:g} minutes, not {minutes:g}; "
                "remove its folder, or take another output folder"
            )
    free: queue.SimpleQueue[str] = queue.SimpleQueue()
    for device in devices:
        free.put(device)

    def finished(name: str) -> bool:
        device = free.get()
        try:
            return _run(name, folder, minutes, device)
        finally:
            free.put(device)

    with ThreadPoolExecutor(len(devices)) as pool:
        good = list(pool.map(finished, waiting))
    return sorted((name for name, went_well in zip(waiting, good) if not went_well), key=list(ROWS).index)


def _run(name: str, folder: Path, minutes: float, device: str) -> bool:
    """One row in a process that sees one device; whether it finished."""
    own = folder / name
    own.mkdir(parents=True, exist_ok=True)
    seen, kind = ({}, "cpu") if device == "cpu" else ({"CUDA_VISIBLE_DEVICES": device}, "cuda")
    command = [sys.executable, "-m", "physkin_studies.ablation_rows", name]
    command += ["--output", str(folder), "--minutes", str(minutes), "--device", kind]
    began = time.perf_counter()
    print(f"{name}: started on {device}", flush=True)
    with open(own / "log.txt", "w") as log:
        status = subprocess.run(command, env=os.environ | seen, stdout=log, stderr=subprocess.STDOUT).returncode
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
    parser.add_argument(
        "--devices", default="0", help="GPU indices with commas between, or cpu (default %(default)s); 0,0 for two rows"
    )
    parser.add_argument("--report", action="store_true", help="train nothing, report on what is finished")
    arguments = parser.parse_args(argv)
    devices = arguments.devices.split(",")
    try:
        if arguments.report:
            from physkin_studies.ablation_report import write_report

            print(f"wrote {write_report(arguments.output)}")
            return 0
        if not 0 < arguments.minutes < math.inf:
            raise ValueError(f"minutes must be above 0 and finite, got {arguments.minutes}")
        if not all(device == "cpu" or device.isdigit() for device in devices):
            raise ValueError(f"devices must be GPU indices with commas between, or cpu, got {arguments.devices!r}")
        return 1 if run_rows(arguments.rows, arguments.output, arguments.minutes, devices=devices) else 0
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main())
