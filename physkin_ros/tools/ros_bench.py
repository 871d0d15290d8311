"""`physkin ros-bench`: how many clouds arrive, how late, and what they cost, between real processes.

A publisher process sends joint states of the bundled motion, a node process drapes, a reader process receives the
clouds; one avatar a garment, their joint states evenly spread in time. What it prints is measured from just before a
joint state is published to when the cloud's bytes are in the reader's callback.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import re
import signal
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml

from physkin_core import load_garment_model
from physkin_ros.middleware.transport import PROFILE_VARIABLES, private_environment
from physkin_ros.tools.children import ChildFailedError, Children
from physkin_ros.tools.machine import machine_line, versions_line
from physkin_ros.tools.ros_bench_listener import READY

__all__ = ["Case", "Row", "main"]

CASES = ("1x60", "1x500", "1x1000", "1x2000", "4x60", "4x200", "4x800", "16x60", "16x200")
START_SECONDS = 90.0
END_SECONDS = 60.0
PLAIN_PROFILE = '<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles/></dds>'
COLUMNS = (
    ("garments", "garments", "d"),
    ("rate_hz", "Hz", "g"),
    ("executor", "executor", "s"),
    ("publish", "publish", "s"),
    ("transport", "transport", "s"),
    ("delivered_percent", "delivered %", ".2f"),
    ("p50_ms", "p50 ms", ".3f"),
    ("p99_ms", "p99 ms", ".3f"),
    ("callback_us", "callback us", ".0f"),
    ("process_us", "process us", ".0f"),
    ("evaluator_p50_us", "evaluator p50", ".1f"),
    ("evaluator_p99_us", "p99", ".1f"),
    ("overhead_us", "overhead us", ".0f"),
    ("load", "load", ".1f"),
)
TARGETS = (
    ("1x60", "p50_ms", "at most", 0.6),
    ("1x60", "p99_ms", "at most", 1.2),
    ("1x500", "delivered_percent", "at least", 99.9),
    ("16x200", "delivered_percent", "at least", 99.9),
    ("1x60", "overhead_us", "at most", 150.0),
    ("1x500", "overhead_us", "at most", 150.0),
    ("16x200", "overhead_us", "at most", 150.0),
)
"""Case, figure, and what is wanted of it with a garment of 6,000 vertices."""


@dataclass(frozen=True)
class Case:
    """What to measure. garments: one an avatar. executor, publish, transport: see the options."""

    garments: int
    rate_hz: float
    executor: str
    publish: str
    transport: str

    @property
    def name(self) -> str:
        """As it is asked for on the command line."""
        return f"{self.garments}x{self.rate_hz:g}"


@dataclass(frozen=True)
class Row:
    """What was measured of a case; figures that there were none for are NaN.

    sent: joint states, and so clouds expected. delivered_percent: clouds that came once, of those. p50_ms, p99_ms: end
    to end. callback_us, process_us: processor time of the node's executor thread, and of all its threads, a cloud
    that came. evaluator_p50_us, evaluator_p99_us: medians over seconds and garments of what the node reports.
    overhead_us: callback_us beyond evaluator_p50_us. load: the machine's load average of a minute, when the case ended.
    """

    case: str
    garments: int
    rate_hz: float
    executor: str
    publish: str
    transport: str
    sent: int
    delivered_percent: float
    p50_ms: float
    p99_ms: float
    callback_us: float
    process_us: float
    evaluator_p50_us: float
    evaluator_p99_us: float
    overhead_us: float
    load: float


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns 0, also where a target is missed; 1 when a process failed."""
    options = _parser().parse_args(argv)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    model = load_garment_model(options.model)
    facts = {
        "machine": machine_line(),
        "versions": versions_line(),
        "garment": f"{model.name}, {len(model.garment.vertices)} vertices, {len(model.node_rest)} garment nodes",
        "queue": options.queue,
        "seconds": options.seconds,
    }
    shown = facts | ({"queue": "the node's own"} if options.queue is None else {})
    print("\n".join(f"{name}: {value}" for name, value in shown.items()), flush=True)
    print(" | ".join(title for _, title, _ in COLUMNS), flush=True)
    rows = []
    combinations = itertools.product(options.executor, options.publish, options.transport, options.cases)
    try:
        for executor, publish, transport, (garments, rate) in combinations:
            with tempfile.TemporaryDirectory(prefix="physkin-ros-bench-") as folder:
                case = Case(garments, rate, executor, publish, transport)
                rows.append(_measure(case, options, Path(folder)))
            print(" | ".join(format(getattr(rows[-1], key), spec) for key, _, spec in COLUMNS), flush=True)
    except ChildFailedError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    targets = _judge(rows)
    for line in targets:
        print(line)
    if options.json:
        document = facts | {"rows": [_finite(asdict(row)) for row in rows], "targets": targets}
        options.json.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return 0


def _measure(case: Case, options: argparse.Namespace, folder: Path) -> Row:
    config, sent, received = folder / "avatars.yaml", folder / "sent.npz", folder / "received.npz"
    config.write_text(yaml.safe_dump({"drape_node": {"ros__parameters": _parameters(case, options)}}))
    environment = private_environment()
    if case.transport == "default":
        (folder / "plain.xml").write_text(PLAIN_PROFILE)
        environment |= dict.fromkeys(PROFILE_VARIABLES, str(folder / "plain.xml"))
    with Children(environment, folder) as children:
        children.start("node", "physkin_core.cli", "node", "--config", config)
        children.start("listener", "physkin_ros.tools.ros_bench_listener", case.garments, received)
        children.wait(lambda: READY in children.log("listener").splitlines(), "the garments", START_SECONDS)
        arguments = (case.rate_hz, options.seconds, case.garments, children.pid("node"), sent)
        children.start("player", "physkin_ros.tools.ros_bench_player", *arguments)
        children.wait(lambda: children.finished("player"), "the joint states", options.seconds * 4 + START_SECONDS)
        children.wait(lambda: children.finished("listener"), "the last cloud", END_SECONDS)
    with np.load(sent) as player, np.load(received) as listener:
        return _row(case, player, listener)


def _parameters(case: Case, options: argparse.Namespace) -> dict[str, object]:
    """The node's parameters."""
    parameters: dict[str, object] = {"executor": case.executor}
    for index in range(case.garments):
        avatar = f"avatars.a{index}"
        parameters[f"{avatar}.orientation"] = "fixed"
        parameters[f"{avatar}.garments.g.model"] = options.model
        if options.queue is not None:
            parameters[f"qos_overrides./a{index}/joint_states.subscription.depth"] = options.queue
    return parameters


def _row(case: Case, player, listener) -> Row:
    stamps, count = player["stamps"], player["stamps"].size
    delivered, delays = 0, []
    for avatar in range(case.garments):
        its = listener["avatars"] == avatar
        came, first, times = np.unique(listener["stamps"][its], return_index=True, return_counts=True)
        wanted = np.isin(came, stamps[:, avatar])
        delivered += int((wanted & (times == 1)).sum())
        delays.append((listener["received"][its][first] - came)[wanted])
    delays = np.concatenate(delays) / 1e6
    p50, p99 = np.percentile(delays, (50, 99)) if len(delays) else (math.nan, math.nan)
    evaluations = listener["evaluations"]
    evaluator = np.median(evaluations, axis=0) if len(evaluations) else (math.nan, math.nan)
    callback, process = 1e6 * player["cpu"] / max(1, delivered)
    return Row(
        case=case.name,
        **asdict(case),
        sent=count,
        delivered_percent=100 * delivered / count,
        p50_ms=float(p50),
        p99_ms=float(p99),
        callback_us=float(callback),
        process_us=float(process),
        evaluator_p50_us=float(evaluator[0]),
        evaluator_p99_us=float(evaluator[1]),
        overhead_us=float(callback - evaluator[0]),
        load=float(player["load"][1]),
    )


def _judge(rows: list[Row]) -> list[str]:
    """A line for each target and row it is about, of the node's defaults."""
    lines = []
    for case, figure, kind, limit in TARGETS:
        for row in rows:
            if (row.case, row.executor, row.publish, row.transport) != (case, "events", "serialised", "shipped"):
                continue
            value = getattr(row, figure)
            met = value <= limit if kind == "at most" else value >= limit
            lines.append(f"target {case} {figure} {kind} {limit:g}: {value:.3f}, {'met' if met else 'MISSED'}")
    return lines


def _finite(values: dict[str, object]) -> dict[str, object]:
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in values.items()}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="physkin ros-bench", description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="OUT", help="write what is printed to a file, too")
    parser.add_argument("--model", default="dress", help="garment: a file or a shipped name (default %(default)s)")
    parser.add_argument("--seconds", type=_positive, default=5.0, help="of each case, after a warm-up (default 5)")
    parser.add_argument(
        "--cases",
        type=_case,
        nargs="+",
        default=[_case(text) for text in CASES],
        metavar="KxHZ",
        help=f"garments and joint states a second of each (default {' '.join(CASES)})",
    )
    parser.add_argument("--executor", nargs="+", choices=("events", "single"), default=["events"])
    parser.add_argument(
        "--publish", nargs="+", choices=("serialised", "message"), default=["serialised"], help="clouds as bytes or not"
    )
    parser.add_argument(
        "--transport", nargs="+", choices=("shipped", "default"), default=["shipped"], help="Fast DDS profile"
    )
    parser.add_argument(
        "--queue", type=_count, metavar="N", help="joint states the node may queue (default: the node's, 50)"
    )
    return parser


def _case(text: str) -> tuple[int, float]:
    match = re.fullmatch(r"([1-9]\d{0,2})x([1-9]\d{0,4})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is no case; write garments and rate, such as 16x200")
    return int(match[1]), float(match[2])


def _count(text: str) -> int:
    if not re.fullmatch(r"[1-9]\d{0,5}", text):
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to 999999, got {text}")
    return int(text)


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be positive and finite, got {text}")
    return value


if __name__ == "__main__":
    sys.exit(main())
