"""`physkin bench`: its keys, what it says of peers that are missing or wrong, and that peers get the same graph."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from physkin_bench.cases import paper_case
from physkin_bench.network_case import network_case
from physkin_bench.network_peers import NETWORK_PEERS
from physkin_bench.peers import Peer, Runner, prepare_peers
from physkin_bench.skinning_peers import SKINNING_PEERS, skinning_case
from physkin_bench.timing import time_in_turns
from physkin_core import cli
from physkin_core.runtime.native_evaluator import PRECISIONS, NativeEvaluator, supported_instruction_sets

DOCUMENT = Path(__file__).parents[2] / "docs" / "benchmark.md"


def run(model_path, tmp_path, peers):
    path = tmp_path / "figures.json"
    command = ["bench", str(model_path), "--no-paper", "--rounds", "2", "--cold-rounds", "1", "--peers", peers]
    assert cli.main([*command, "--json", str(path)]) == 0
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def figures(model_path, tmp_path_factory):
    """A short run against NumPy, with LiteRT and numba not installed."""
    with pytest.MonkeyPatch.context() as patch:
        for package in ("ai_edge_litert", "ai_edge_litert.interpreter", "numba"):
            patch.setitem(sys.modules, package, None)
        return run(model_path, tmp_path_factory.mktemp("bench"), "numpy,litert_fp32,numba")


def test_times_are_told_for_every_stage_precision_and_instruction_set(figures):
    names = [f"{stage}." for stage in ("posing", "networks", "composition", "skinning", "frame")]
    names += [f"{p}.{level}.{name}" for p in PRECISIONS for level in supported_instruction_sets() for name in names]
    for name in names:
        minimum, median, p99 = (figures[f"{name}us.{figure}"] for figure in ("min", "p50", "p99"))
        assert 0 < minimum <= median <= p99
    widest = supported_instruction_sets()[-1]
    assert figures["frame.us.p50"] == figures[f"fp32.{widest}.frame.us.p50"]
    assert figures["frame.us.min"] > figures["skinning.us.min"]
    assert all(figures[f"cold.frame.{p}.us.p50"] > 0 and figures[f"cold.networks.{p}.us.p50"] > 0 for p in PRECISIONS)


def test_times_of_several_bodies_are_a_body_s(figures):
    """Together, in any number, and one by one; normals from faces where there are faces."""
    for precision in PRECISIONS:
        assert all(figures[f"batch.{precision}.{count}.us.min"] > 0 for count in (1, 2, 4, 8))
        assert figures[f"singles.{precision}.us.min"] > figures[f"batch.{precision}.8.us.min"] / 3
    assert all(figures[f"{level}.face_normals.us.min"] > 0 for level in supported_instruction_sets())


def test_limits_and_errors_are_told(figures):
    assert all(figures[f"floor.{name}"] > 0 for name in ("fma.gmacs", "l2.gbs", "l3.gbs", "memory.gbs"))
    assert all(0 < figures[f"floor.{name}.share"] < 10 for name in ("networks", "networks_bf16", "skinning"))
    assert figures["error.fp32.vertices.mm.max"] < 0.01 < 10 > figures["error.bf16.vertices.mm.max"]
    assert abs(figures["error.fp32.edge_strain.percent.change"]) < 1e-4
    assert figures["machine.cpu"] and figures["versions.numpy"] == np.__version__


def test_missing_peers_are_named(figures):
    """And what they would be divided into is null."""
    for peer in ("networks.litert_fp32", "skinning.numba"):
        assert "not installed" in figures["missing"][peer] and "physkin[bench]" in figures["missing"][peer]
    assert figures["ratio.networks_bf16_vs_litert_fp32"] is None and figures["ratio.frame_int8"] is None
    if "skinning.numpy" in figures["missing"]:
        pytest.skip("needs threadpoolctl: pip install 'physkin[bench]'")
    quotient = figures["peers.skinning.numpy.us.p50"] / figures["skinning.us.p50"]
    assert figures["ratio.skinning_vs_best_peer"] == pytest.approx(quotient)


def test_every_key_is_documented(figures):
    """A key matches a line of the table in docs/benchmark.md, its capital words standing for names."""
    rows = re.findall(r"^\| `([^|]*)` \|", DOCUMENT.read_text(), flags=re.MULTILINE)
    patterns = [re.sub("[A-Z]+", "[a-z0-9_-]+", re.escape(row)) for row in rows]
    assert [key for key in figures if not any(re.fullmatch(pattern, key) for pattern in patterns)] == []


def test_unknown_peer_or_round_is_refused(capsys):
    assert cli.main(["bench", "--peers", "eigen"]) == 2
    assert cli.main(["bench", "--rounds", "0"]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert errors[0].startswith("error: no peer eigen; known: ") and errors[1].startswith("error: rounds must be 1")


# --- Peers ---


def test_peers_that_fail_or_differ_are_left_out():
    """Neither may end the benchmark, nor be timed."""
    expected = np.array([1.0, 2.0])

    def broken(case):
        raise RuntimeError("no such device\nat line 3")

    def giving(values):
        return lambda case: Runner(lambda: None, lambda: np.array(values))

    peers = [
        Peer("right", (), giving([1.0, 2.0001]), 1e-3),
        Peer("wrong", (), giving([1.0, 2.1]), 1e-3),
        Peer("nan", (), giving([1.0, np.nan]), 1e-3),
        Peer("broken", (), broken, 1e-3),
    ]
    calls, missing = prepare_peers(peers, None, expected)
    assert list(calls) == ["right"] and missing.keys() == {"wrong", "nan", "broken"}
    assert missing["broken"] == "failed: RuntimeError: no such device"
    assert "another result: relative error 5.0e-02" in missing["wrong"]


@pytest.mark.parametrize("activation", ["silu", "relu"])
@pytest.mark.parametrize("name", [peer.name for peer in NETWORK_PEERS if peer.name != "torch_aot_inductor"])
def test_network_peer_computes_the_same(name, activation):
    """On the paper's sizes; a peer that is not installed is skipped. The graph itself is the native evaluator's."""
    case = paper_case(activation)
    pose = case.joint_positions[0], case.gravity[0]
    networks = network_case(case.bound, *pose)
    evaluator = NativeEvaluator(case.bound, precision="fp32")
    evaluator.evaluate(*pose, np.empty((len(case.bound.vertices), 3), dtype=np.float32))
    np.testing.assert_allclose(evaluator.corrections().reshape(1, -1), networks.expected, atol=1e-5)
    calls, missing = prepare_peers([peer for peer in NETWORK_PEERS if peer.name == name], networks, networks.expected)
    if "not installed" in missing.get(name, ""):
        pytest.skip(missing[name])
    assert missing == {} and list(calls) == [name]


@pytest.mark.parametrize("name", [peer.name for peer in SKINNING_PEERS])
def test_skinning_peer_computes_the_same(name):
    case = paper_case("silu")
    evaluator = NativeEvaluator(case.bound, precision="fp32")
    out = np.empty((len(case.bound.vertices), 6), dtype=np.float32)
    evaluator.evaluate(case.joint_positions[0], case.gravity[0], out)
    skinning = skinning_case(case.bound, evaluator.node_transforms())
    np.testing.assert_allclose(out, skinning.expected, atol=1e-5)
    calls, missing = prepare_peers([peer for peer in SKINNING_PEERS if peer.name == name], skinning, skinning.expected)
    if "not installed" in missing.get(name, ""):
        pytest.skip(missing[name])
    assert missing == {} and list(calls) == [name]


# --- Timing ---


def test_calls_take_turns():
    """One untimed call opens a turn; with cold caches it is left out, and something else comes before every call."""
    order = []
    calls = {name: (lambda name=name: order.append(name)) for name in "ab"}
    timings = time_in_turns(calls, rounds=2, repeats=2)
    assert "".join(order) == "aaabbb" * 2
    assert all(timing.count == 4 and 0 < timing.min <= timing.p50 <= timing.p99 for timing in timings.values())
    order.clear()
    time_in_turns(calls, rounds=1, repeats=2, before_each=lambda: order.append("-"))
    assert "".join(order) == "-a-a-b-b"
