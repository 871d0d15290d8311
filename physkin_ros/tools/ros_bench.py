"""What the node delivers, how late, and at what cost: `python -m physkin_ros.tools.ros_bench`.

A publisher process sends joint states of the bundled motion, a node process drapes, a reader process receives the
clouds; each avatar wears a garment of each `--garment`, their joint states evenly spread in time. What it prints is
measured from just before a joint state is published to when its last cloud's bytes are in the reader's callback.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import sys
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from physkin_core import load_garment_model, load_motion
from physkin_core.machine import machine_line, versions_line
from physkin_core.outfit.outfit_options import add_options
from physkin_ros.arguments import file_to_write, positive, whole_number
from physkin_ros.middleware.transport import private_environment
from physkin_ros.tools.trial import NodeProcess, Records, TrialError, node_parameters, play_to_node

__all__ = ["Case", "command_parser", "figures", "main"]

MOTION = "dance"
WARM_UP_SECONDS = 1.0

CASES = ("1x60", "1x500", "1x1000", "1x2000", "4x60", "4x200", "4x800", "16x60", "16x200")
COLUMNS = (
    ("avatars", "avatars", "d"),
    ("rate_hz", "Hz", "g"),
    ("delivered_percent", "delivered %", ".2f"),
    ("p50_ms", "p50 ms", ".3f"),
    ("p99_ms", "p99 ms", ".3f"),
    ("callback_us", "callback µs", ".0f"),
    ("process_us", "process µs", ".0f"),
    ("evaluator_p50_us", "evaluator p50 µs", ".1f"),
    ("evaluator_p99_us", "p99 µs", ".1f"),
    ("overhead_us", "overhead µs", ".0f"),
    ("load", "load", ".1f"),
)


@dataclass(frozen=True)
class Case:
    """What to measure."""

    avatars: int
    rate_hz: float

    @property
    def name(self) -> str:
        """As it is asked for on the command line."""
        return f"{self.avatars}x{self.rate_hz:g}"


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0; 1 when a process failed."""
    options = command_parser().parse_args(argv)
    options.garment = options.garment or ["dress"]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    models = [load_garment_model(name) for name in options.garment]
    facts = {
        "machine": machine_line(),
        "versions": versions_line("physkin", "ros-jazzy-rclpy", "numpy"),
        "garments of an avatar": "; ".join(
            f"{model.name}, {len(model.garment.vertices)} vertices, {len(model.node_rest)} garment nodes"
            for model in models
        ),
        "queue": options.queue,
        "seconds": options.seconds,
    }
    shown = facts | ({"queue": "the node's own"} if options.queue is None else {})
    print("\n".join(f"{name}: {value}" for name, value in shown.items()), flush=True)
    os.environ.update(private_environment())
    print(" | ".join(title for _, title, _ in COLUMNS), flush=True)
    rows = []
    try:
        for case in options.cases:
            with tempfile.TemporaryDirectory(prefix="physkin-ros-bench-") as folder:
                rows.append(figures(case, _measure(case, options, Path(folder))))
            shown = (rows[-1][key] for key, _, _ in COLUMNS)
            cells = ("-" if value is None else format(value, spec) for value, (_, _, spec) in zip(shown, COLUMNS))
            print(" | ".join(cells), flush=True)
    except TrialError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    if options.json:
        document = facts | {"rows": rows}
        options.json.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return 0


def _measure(case: Case, options: argparse.Namespace, folder: Path) -> Records:
    garments = [{"model": model} for model in options.garment]
    if options.fit is not None:
        garments = [garment | {"fit": options.fit} for garment in garments]
    parameters = node_parameters(case.avatars, garments)
    if options.queue is not None:
        parameters["qos_overrides"] = {
            f"/a{k}/joint_states": {"subscription": {"depth": options.queue}} for k in range(case.avatars)
        }
    motion = load_motion(MOTION).resampled(case.rate_hz).looped(options.seconds + WARM_UP_SECONDS)
    with NodeProcess(parameters, folder) as node:
        watched = {"warm_up": _warm_up(case), "measure": partial(_processor_time, node.pid)}
        return play_to_node(motion, avatars=case.avatars, garments=len(garments), check=node.check, **watched)


def _warm_up(case: Case) -> int:
    """Joint states of each avatar that only the share of those delivered counts."""
    return round(WARM_UP_SECONDS * case.rate_hz)


def _processor_time(pid: int) -> tuple[float, float, float]:
    """Processor time [s] of a process's first thread and of all its living threads, and the machine's load average of
    a minute. Linux only: raises OSError."""
    total = 0.0
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            total += int((task / "schedstat").read_text().split()[0]) / 1e9
        except FileNotFoundError:  # the thread has ended meanwhile
            continue
    first = int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[0]) / 1e9
    return first, total, os.getloadavg()[0]


def figures(case: Case, records: Records) -> dict[str, object]:
    """What was measured of a case; figures that there were none for are None.

    sent: joint states. delivered_percent: those of which all clouds came once, with the warm-up; all else is without.
    p50_ms, p99_ms: end to end, to the last cloud. callback_us, process_us: processor time of the node's executor
    thread, and of all its threads, a joint state that was delivered. evaluator_p50_us, evaluator_p99_us: medians over
    seconds and garments of what the node reports, of an outfit as a whole. overhead_us: callback_us beyond
    evaluator_p50_us.
    load: the machine's load average of a minute, when the case ended.
    """
    once, delays, warm_up = (records.counts == 1).all(axis=2), records.delays.max(axis=2), _warm_up(case)
    late = delays[warm_up:][np.isfinite(delays[warm_up:])]
    p50, p99 = np.percentile(late, (50, 99)).tolist() if len(late) else (None, None)
    (*before, _), (*after, load) = records.measured or [(0.0, 0.0, 0.0)] * 2
    callback, process = 1e6 * np.subtract(after, before) / max(1, once[warm_up:].sum())
    reported = [report for report in records.reports if report["evaluation p50 [us]"] != "none"]
    evaluations = [[float(report[f"evaluation {which} [us]"]) for which in ("p50", "p99")] for report in reported]
    evaluator = np.median(evaluations, axis=0).tolist() if evaluations else (None, None)
    return {
        "case": case.name,
        **vars(case),
        "sent": once.size,
        "delivered_percent": float(100 * once.mean()),
        "p50_ms": p50,
        "p99_ms": p99,
        "callback_us": float(callback),
        "process_us": float(process),
        "evaluator_p50_us": evaluator[0],
        "evaluator_p99_us": evaluator[1],
        "overhead_us": float(callback - evaluator[0]) if evaluations else None,
        "load": load,
    }


def command_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog="python -m physkin_ros.tools.ros_bench", description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=file_to_write, metavar="OUT", help="write what is printed to a file, too")
    add_options(parser, "garment", "fit", worn="dress")
    parser.add_argument("--seconds", type=positive, default=5.0, help="of each case, after a warm-up (default 5)")
    parser.add_argument(
        "--cases",
        type=_case,
        nargs="+",
        default=[_case(text) for text in CASES],
        metavar="KxHZ",
        help=f"avatars and joint states a second of each (default {' '.join(CASES)})",
    )
    parser.add_argument(
        "--queue", type=whole_number(1), metavar="N", help="joint states the node may queue (default: the node's, 200)"
    )
    return parser


def _case(text: str) -> Case:
    match = re.fullmatch(r"([1-9]\d{0,2})x([1-9]\d{0,4})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is no case; write avatars and rate, such as 16x200")
    return Case(int(match[1]), float(match[2]))


if __name__ == "__main__":
    sys.exit(main())
