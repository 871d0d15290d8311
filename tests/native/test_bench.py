"""The benchmarks: their keys, and how calls take turns."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from physkin_bench.__main__ import main
from physkin_core import cli
from physkin_core.bench import STAGES, time_in_turns
from physkin_core.runtime.evaluator import PRECISIONS, supported_instruction_sets

DOCUMENT = Path(__file__).parents[2] / "docs" / "notebook" / "benchmark.md"


@pytest.fixture(scope="module")
def figures(model_path, tmp_path_factory):
    """A short run."""
    path = tmp_path_factory.mktemp("bench") / "figures.json"
    assert main([str(model_path), "--no-paper", "--rounds", "1", "--json", str(path)]) == 0
    return json.loads(path.read_text())


def test_times_and_errors_are_told(figures):
    """With their spread, for every stage, precision and instruction set; where they were measured."""
    levels = supported_instruction_sets()
    names = [f"{p}.{level}.{stage}" for p in PRECISIONS for level in levels for stage in STAGES]
    names += [f"{name}.{p}" for name in ("cold.frame", "cold.networks") for p in PRECISIONS]
    names += [f"separate_limbs.{level}" for level in levels]
    for name in names:
        minimum, median, p99 = (figures[f"{name}.us.{figure}"] for figure in ("min", "p50", "p99"))
        assert 0 < minimum <= median <= p99
    assert 0 < figures["error.bf16.vertices.mm.max"] < 10
    assert " cores, " in figures["machine"] and f"numpy {np.__version__}" in figures["versions"]


def test_every_key_is_documented(figures):
    """A key matches a line of the table in the notebook, its capital words standing for names."""
    rows = re.findall(r"^\| `([^|]*)` \|", DOCUMENT.read_text(), flags=re.MULTILINE)
    patterns = [re.sub("[A-Z]+", "[a-z0-9_.-]+", re.escape(row)) for row in rows]
    assert [key for key in figures if not any(re.fullmatch(pattern, key) for pattern in patterns)] == []


def test_rounds_below_one_are_refused(capsys):
    assert cli.main(["bench", "--rounds", "0"]) == 2
    assert "--rounds must be 1 or more, got 0" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--rounds", "0"])
    assert "must be 1 or more, got 0" in capsys.readouterr().err


def test_what_is_installed_times_this_machine(model_path, tmp_path, capsys):
    """Its stages in a table, and the same keys in the file."""
    path = tmp_path / "mine.json"
    assert cli.main(["bench", str(model_path), "--rounds", "1", "--json", str(path)]) == 0
    figures, level = json.loads(path.read_text()), supported_instruction_sets()[-1]
    assert figures["machine"] and figures["model"] == "vest"
    assert f"| int8 | {level} | {figures[f'int8.{level}.posing.us.p50']:.1f} (" in capsys.readouterr().out


def test_calls_take_turns():
    """One untimed call opens a turn; with cold caches it is left out, and something else comes before every call."""
    order = []
    calls = {name: (lambda name=name: order.append(name)) for name in "ab"}
    timings = time_in_turns(calls, rounds=2, repeats=2)
    assert "".join(order) == "aaabbb" * 2
    assert all(0 < timing.min <= timing.p50 <= timing.p99 for timing in timings.values())
    order.clear()
    time_in_turns(calls, rounds=1, repeats=2, before_each=lambda: order.append("-"))
    assert "".join(order) == "-a-a-b-b"
