"""The benchmarks: their keys, what they say of peers that are missing or wrong, and that peers get the same graph."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_models import random_detail

from physkin_bench import measurement
from physkin_bench.__main__ import main, peer_rows
from physkin_bench.cases import paper_case, skinning_case
from physkin_bench.litert_networks import network_case
from physkin_bench.peers import NETWORK_PEERS, SKINNING_PEERS, Peer, prepare_peers
from physkin_core import bench as installed
from physkin_core import cli
from physkin_core.bench import STAGES, time_cold, time_in_turns
from physkin_core.runtime.evaluator import PRECISIONS, Evaluator, supported_instruction_sets

DOCUMENT = Path(__file__).parents[2] / "docs" / "notebook" / "benchmark.md"


@pytest.fixture(scope="module")
def figures(model_path, tmp_path_factory):
    """A short run with LiteRT not installed."""
    path = tmp_path_factory.mktemp("bench") / "figures.json"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
        patch.setattr(measurement, "SKINNING_PEERS", ())
        command = [str(model_path), "--no-paper", "--rounds", "1"]
        assert main([*command, "--json", str(path)]) == 0
    return json.loads(path.read_text())


def test_times_and_errors_are_told(figures):
    """With their spread, for every stage, precision and instruction set, and cold for those that are compared; bytes;
    where they were measured."""
    levels = supported_instruction_sets()
    names = [f"{p}.{level}.{stage}" for p in PRECISIONS for level in levels for stage in STAGES]
    compared = [f"{p}.{level}.{stage}" for p in PRECISIONS for level in levels[-1:] for stage in ("frame", "networks")]
    names += [f"{state}.{name}" for state in ("cold", "emptied") for name in compared]
    names += [f"separate_limbs.{level}" for level in levels]
    for name in names:
        minimum, median, p99 = (figures[f"{name}.us.{figure}"] for figure in ("min", "p50", "p99"))
        assert 0 < minimum <= median <= p99
    for name in (f"{p}.{level}" for p in PRECISIONS for level in levels):
        stages = [figures[f"{name}.{stage}.bytes"] for stage in STAGES]
        assert min(stages) > 0 and sum(stages[:-1]) == stages[-1]
    assert 0 < figures["error.bf16.vertices.mm.max"] < 10
    assert " cores, " in figures["machine"] and f"numpy {np.__version__}" in figures["versions"]
    assert all("not installed" in figures["missing"][f"networks.litert_{kind}"] for kind in ("fp32", "int8"))


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
    """First what is used by default, warm, cold and in bytes; then stages in tables. The same keys are in the file."""
    path = tmp_path / "mine.json"
    assert cli.main(["bench", str(model_path), "--rounds", "1", "--json", str(path)]) == 0
    figures, level = json.loads(path.read_text()), supported_instruction_sets()[-1]
    first, *lines = capsys.readouterr().out.splitlines()
    usual = f"int8.{level}.frame"
    touched = f"{figures[f'{usual}.bytes'] / 1e3:,.0f}"
    assert figures["model"] == "vest"
    assert first == f"vest, {figures['vertices']} vertices, a frame touches {touched} KB; {figures['machine']}"
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines]
    frame = next(row for row in rows if row[0] == f"frame, int8 on {level}")
    drape = next(row for row in rows if row[0] == "the same by `Draper.drape`")
    for row, name in ((frame, usual), (drape, "drape")):
        for cell, timed in zip(row[1:], (name, f"cold.{name}"), strict=True):
            assert cell.split(" (")[0] == f"{figures[f'{timed}.us.p50']:.1f}"
    stages = next(row for row in rows if row[:2] == ["int8", level])
    assert stages[2].startswith(f"{figures[f'int8.{level}.posing.us.p50']:.1f} (") and stages[-1].startswith(
        frame[2][:4]
    )
    assert next(row for row in rows if row[0] == "int8" and len(row) == len(STAGES) + 1)[-1] == touched


def test_peers_that_fail_or_differ_are_left_out():
    """Neither may end the benchmark, nor be timed."""

    def broken(case):
        raise RuntimeError("no such device\nat line 3")

    def giving(*values):
        return lambda case: (lambda: None, lambda: np.array(values))

    peers = [Peer("right", giving(1.0, 2.0001)), Peer("wrong", giving(1.0, 2.1))]
    peers += [Peer("nan", giving(1.0, np.nan)), Peer("broken", broken)]
    calls, missing = prepare_peers(peers, None, np.array([1.0, 2.0]))
    assert list(calls) == ["right"] and missing.keys() == {"wrong", "nan", "broken"}
    assert missing["broken"] == "failed: RuntimeError: no such device" and "5.0e-02" in missing["wrong"]


def folded(bound):
    """A bound garment with detail."""
    rng = np.random.default_rng(6)
    detail = random_detail(rng, bound, 40, width=len(bound.deformer_layers[-2][1]), offset=0.005)
    return replace(
        bound,
        detail_layers=(detail.features,),
        detail_offsets=detail.offsets,
        detail_nodes=detail.nodes,
        detail_weights=detail.weights,
    )


@pytest.mark.parametrize("has_detail", [False, True])
def test_peers_compute_the_same(has_detail):
    """On the paper's sizes; one that is not installed is left out. The graph itself is the native evaluator's."""
    case = paper_case()
    bound = folded(case.bound) if has_detail else case.bound
    evaluator = Evaluator([bound], precision="fp32")
    out = np.empty((len(bound.vertices), 6), dtype=np.float32)
    evaluator.evaluate(case.joint_positions[0], case.inputs[0], [out])
    networks = network_case(bound, case.joint_positions[0], case.inputs[0])
    assert networks.expected.shape == (1, 12 * len(bound.node_rest) + (120 if has_detail else 0))
    skinning = skinning_case(bound, evaluator.node_transforms(), evaluator.detail_offsets())
    np.testing.assert_allclose(out, skinning.expected, atol=1e-5)
    for peers, task in ((NETWORK_PEERS, networks), (SKINNING_PEERS, skinning)):
        _, missing = prepare_peers(peers, task, task.expected)
        assert [reason for reason in missing.values() if "not installed" not in reason] == []


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


def test_before_a_cold_call_the_program_sleeps(monkeypatch):
    """As long as a frame at 60 Hz takes, and never within the time of a call."""
    order = []
    monkeypatch.setattr(installed, "sleep", lambda seconds: order.append(seconds))
    timings = time_cold({name: (lambda name=name: order.append(name)) for name in "ab"}, rounds=100)
    turn = [each for name in "ab" for each in [0.016, name] * 10]
    assert order == turn * 4 and list(timings) == ["cold.a", "cold.b"]


def test_peers_are_compared_with_what_was_measured_alike():
    """Warm with warm, cold with cold; one whose counterpart was not timed has no row."""
    level = supported_instruction_sets()[-1]
    times = {"peers.networks.litert_int8": 30.0, "cold.peers.networks.litert_int8": 200.0}
    times |= {f"int8.{level}.networks": 20.0, f"cold.int8.{level}.networks": 50.0, "emptied.peers.networks.a_int8": 9.0}
    figures = {f"{name}.us.{figure}": time for name, time in times.items() for figure in ("min", "p50", "p99")}
    rows = [(row[0], row[2], row[-1]) for row in peer_rows(figures, list(times))]
    assert rows == [
        ("peers.networks.litert_int8", f"int8.{level}.networks", "1.50"),
        ("cold.peers.networks.litert_int8", f"cold.int8.{level}.networks", "4.00"),
    ]
