"""`physkin ros-bench`: its arithmetic on made-up records, and a short run between real processes."""

from __future__ import annotations

import json
import math
import os
import time

import numpy as np
import pytest

from physkin_core import cli

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from physkin_ros.tools import ros_bench  # noqa: E402
from physkin_ros.tools.machine import cpu_seconds  # noqa: E402
from physkin_ros.tools.ros_bench import Case  # noqa: E402

MILLISECOND = 1_000_000


def records(delays_ms, repeated=()):
    """Records of two avatars' ten joint states each, the clouds that come late by `delays_ms`, None for a lost one."""
    stamps = np.arange(20, dtype=np.int64).reshape(10, 2) * 5 * MILLISECOND
    came = [(k % 2, stamp, stamp + d * MILLISECOND) for k, (stamp, d) in enumerate(zip(stamps.ravel(), delays_ms)) if d]
    came += [came[k] for k in repeated] + [(0, -7, 0)]  # and one of the warm-up
    avatars, kept, received = map(np.array, zip(*came))
    evaluations = np.array([[50.0, 70.0], [54.0, 90.0], [52.0, 80.0]])
    player = {"stamps": stamps, "cpu": np.array([0.0036, 0.0054]), "load": np.array([1.0, 2.0])}
    return player, {"avatars": avatars, "stamps": kept, "received": received, "evaluations": evaluations}


def test_figures_of_a_case():
    """Share of clouds that came once, percentiles of those that came, processor time for each of them."""
    row = ros_bench._row(Case(2, 100.0, "events", "serialised", "shipped"), *records([1] * 18 + [3, 0], repeated=[0]))
    assert (row.case, row.sent, row.delivered_percent) == ("2x100", 20, 90.0)  # one lost, one twice
    assert row.p50_ms == 1.0 and row.p99_ms == pytest.approx(np.percentile([1] * 18 + [3], 99))
    assert (row.callback_us, row.process_us) == (pytest.approx(200.0), pytest.approx(300.0))
    assert (row.evaluator_p50_us, row.evaluator_p99_us, row.load) == (52.0, 80.0, 2.0)
    assert row.overhead_us == pytest.approx(148.0)


def test_targets_are_judged_on_the_defaults():
    """Of rows with another executor nothing is said; a figure that there is none for is a target missed."""
    row = ros_bench._row(Case(2, 100.0, "events", "serialised", "shipped"), *records([1] * 20))
    fields = vars(row) | {"case": "1x60", "p50_ms": 0.6, "p99_ms": math.nan, "overhead_us": 151.0}
    rows = [ros_bench.Row(**fields), ros_bench.Row(**fields | {"executor": "single"})]
    lines = [line for line in ros_bench._judge(rows) if "1x60" in line]
    assert [line.rpartition(" ")[2] for line in lines] == ["met", "MISSED", "MISSED"]


def test_processor_time_is_counted():
    """Of the first thread, and of all."""
    before = cpu_seconds(os.getpid())
    start = time.thread_time()
    while time.thread_time() < start + 0.05:
        pass
    first, total = cpu_seconds(os.getpid())
    assert first - before[0] > 0.04 and total >= first


@pytest.mark.parametrize("arguments", [["--cases", "0x60"], ["--cases", "16"], ["--seconds", "nan"], ["--queue", "0"]])
def test_wrong_arguments(arguments, capsys):
    """Argument errors name the value."""
    with pytest.raises(SystemExit):
        cli.main(["ros-bench", *arguments])
    assert arguments[1] in capsys.readouterr().err


def test_a_run(start, model_path, tmp_path):
    """Three processes, every cloud received, the same figures on the terminal and in the file."""
    path = tmp_path / "figures.json"
    options = ["--model", str(model_path), "--seconds", "1", "--cases", "2x30", "--publish", "message", "--queue", "60"]
    bench = start("physkin_core.cli", "ros-bench", *options, "--json", str(path))
    output, _ = bench.communicate(timeout=120)
    assert bench.returncode == 0, output
    document = json.loads(path.read_text())
    (row,) = document["rows"]
    assert (row["sent"], row["delivered_percent"], row["publish"]) == (60, 100.0, "message")
    assert 0 < row["evaluator_p50_us"] < row["callback_us"] <= row["process_us"]
    assert 0 < row["p50_ms"] <= row["p99_ms"]
    assert f" | {row['p50_ms']:.3f} | {row['p99_ms']:.3f} | " in output and document["machine"] in output
