"""The benchmark of the node: its arithmetic on made-up records, and a short run between real processes."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from physkin_ros.tools.ros_bench import Case, figures, main  # noqa: E402

CASE = Case(2, 5.0)  # whose warm-up is the first five joint states of each avatar


def test_figures_of_a_case(made_records):
    """Share of all clouds that came once, also in the warm-up; without that, percentiles and processor time."""
    row = figures(CASE, made_records([9, None] + [8] * 8 + [1] * 18 + [3, None], avatars=2, repeated=[12]))
    assert (row["case"], row["sent"], row["delivered_percent"]) == ("2x5", 30, 90.0)  # two lost, one twice
    assert row["p50_ms"] == 1.0 and row["p99_ms"] == pytest.approx(np.percentile([1] * 18 + [3], 99))
    assert (row["callback_us"], row["process_us"]) == (pytest.approx(200.0), pytest.approx(300.0))
    assert (row["evaluator_p50_us"], row["evaluator_p99_us"], row["load"]) == (52.0, 80.0, 2.0)
    assert row["overhead_us"] == pytest.approx(148.0)
    nothing = figures(CASE, made_records([None] * 20, avatars=2, reports=[], measured=()))
    assert nothing["delivered_percent"] == 0 and nothing["p99_ms"] is nothing["overhead_us"] is None


@pytest.mark.parametrize(
    "arguments",
    [["--cases", "0x60"], ["--cases", "16"], ["--seconds", "nan"], ["--queue", "0"], ["--json", "no/a.json"]],
)
def test_wrong_arguments(arguments, capsys):
    """Told before anything is started, by their value."""
    with pytest.raises(SystemExit):
        main(arguments)
    assert arguments[1] in capsys.readouterr().err


@pytest.mark.slow
def test_a_run(start, model_path, tmp_path):
    """Three processes, every cloud received, the same figures on the terminal and in the file."""
    path = tmp_path / "figures.json"
    options = ["-g", str(model_path), "--seconds", "1", "--cases", "2x30", "--queue", "60", "--json", str(path)]
    bench = start("physkin_ros.tools.ros_bench", *options)
    output, _ = bench.communicate(timeout=180)
    assert bench.returncode == 0, output
    document = json.loads(path.read_text())
    (row,) = document["rows"]
    assert (row["sent"], row["delivered_percent"]) == (120, 100.0)
    assert 0 < row["evaluator_p50_us"] < row["callback_us"] <= row["process_us"]
    assert 0 < row["p50_ms"] <= row["p99_ms"]
    assert f" | {row['p50_ms']:.3f} | {row['p99_ms']:.3f} | " in output and document["machine"] in output
