"""One case of the benchmark: the native evaluator in every precision, its peers, and the machine's limits, in turns."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from physkin_bench.cases import BenchmarkCase
from physkin_bench.network_case import network_case
from physkin_bench.network_peers import NETWORK_PEERS
from physkin_bench.peers import Peer, prepare_peers
from physkin_bench.skinning_peers import SKINNING_PEERS, skinning_case
from physkin_bench.timing import Timing, time_in_turns
from physkin_core import _native
from physkin_core.quality import edge_strain
from physkin_core.runtime.native_evaluator import (
    PRECISIONS,
    NativeEvaluator,
    NativeEvaluatorBatch,
    supported_instruction_sets,
)
from physkin_core.runtime.reference_evaluator import ReferenceEvaluator

__all__ = ["BYTES_A_WEIGHT", "CaseResult", "measure_case"]

STAGES = {
    "posing": "pose",
    "networks": "run_networks",
    "composition": "compose_nodes",
    "skinning": "skin",
    "frame": "step",
}
"""Stage -> method of a bound step."""

BYTES_A_WEIGHT = {"fp32": 4, "bf16": 2, "int8": 1}
"""Bytes of a network weight; in int8 the node deformer's first layer has as many as in bf16."""
MULTIPLY_ADD_ROUNDS = 5000
L2_BYTES, L3_BYTES, MEMORY_BYTES = 512 << 10, 4 << 20, 256 << 20
BATCH_SIZES = (1, 2, 4, 8)
COLD_PEERS = ("litert_fp32", "litert_int8")


@dataclass
class CaseResult:
    """Figures of one case.

    native: timings by (precision, instruction set, stage). batches: a body's, by (precision, bodies at once). singles:
    a body's, by precision, where as many bodies as the largest batch have an evaluator each. face_normals: those of
    faces, by instruction set; none without faces. cold: by name, caches emptied before every call.
    network_peers, skinning_peers: timings by name. missing: why a peer was left out.
    probes: "fma", "l2", "l3", "memory" and reading as many bytes as each precision's network weights. amounts: what a
    probe does a call (multiply-adds or bytes). errors: by precision and figure. weight_count, skinning_terms: the sizes
    of the work.
    """

    case: BenchmarkCase
    weight_count: int
    skinning_terms: int
    native: dict[tuple[str, str, str], Timing] = field(default_factory=dict)
    batches: dict[tuple[str, int], Timing] = field(default_factory=dict)
    singles: dict[str, Timing] = field(default_factory=dict)
    face_normals: dict[str, Timing] = field(default_factory=dict)
    network_peers: dict[str, Timing] = field(default_factory=dict)
    skinning_peers: dict[str, Timing] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)
    probes: dict[str, Timing] = field(default_factory=dict)
    amounts: dict[str, int] = field(default_factory=dict)
    cold: dict[str, Timing] = field(default_factory=dict)
    errors: dict[str, dict[str, float]] = field(default_factory=dict)


def measure_case(
    case: BenchmarkCase,
    *,
    rounds: int,
    cold_rounds: int,
    network_peers: Iterable[Peer] = NETWORK_PEERS,
    skinning_peers: Iterable[Peer] = SKINNING_PEERS,
) -> CaseResult:
    """Check and time everything there is for a case. rounds, cold_rounds: turns that each thing to time gets."""
    middle = len(case.joint_positions) // 2
    bound, pose, gravity = case.bound, case.joint_positions[middle].copy(), case.gravity[middle].copy()
    evaluators, steps, outputs = {}, {}, []
    for level in supported_instruction_sets():
        for precision in PRECISIONS:
            evaluator = NativeEvaluator(bound, instruction_set=level, precision=precision)
            outputs.append(np.empty((len(bound.vertices), 6), dtype=np.float32))
            steps[precision, level] = evaluator.bind_step(pose, gravity, outputs[-1])
            steps[precision, level].step()
            evaluators[precision, level] = evaluator
    widest = supported_instruction_sets()[-1]
    exact = evaluators["fp32", widest]
    networks = network_case(bound, pose, gravity)
    skinning = skinning_case(bound, exact.node_transforms())
    result = CaseResult(
        case=case,
        weight_count=networks.weight_count,
        skinning_terms=exact.skinning_terms,
    )
    network_calls, missing = prepare_peers(network_peers, networks, networks.expected)
    result.missing |= {f"networks.{name}": reason for name, reason in missing.items()}
    skinning_calls, missing = prepare_peers(skinning_peers, skinning, skinning.expected)
    result.missing |= {f"skinning.{name}": reason for name, reason in missing.items()}
    probes = _probes(result, widest)

    calls: dict[tuple, Callable[[], object]] = {
        ("native", precision, level, stage): getattr(step, method)
        for (precision, level), step in steps.items()
        for stage, method in STAGES.items()
    }
    calls |= _body_calls(case, middle)
    if len(bound.faces):
        for level in supported_instruction_sets():
            evaluator = NativeEvaluator(bound, instruction_set=level, normals="faces")
            outputs.append(np.empty((len(bound.vertices), 6), dtype=np.float32))
            step = evaluator.bind_step(pose, gravity, outputs[-1])
            step.step()
            calls["normals", level] = step.compute_normals
    calls |= {("networks", name): call for name, call in network_calls.items()}
    calls |= {("skinning", name): call for name, call in skinning_calls.items()}
    calls |= {("probe", *way): call for way, call in probes.items()}
    for key, timing in time_in_turns(calls, rounds=rounds).items():
        match key:
            case "native", *names:
                result.native[tuple(names)] = timing
            case "batch", precision, count:
                result.batches[precision, count] = timing.shared_by(count)
            case "singles", precision:
                result.singles[precision] = timing.shared_by(len(case.bodies))
            case "normals", level:
                result.face_normals[level] = timing
            case "networks", name:
                result.network_peers[name] = timing
            case "skinning", name:
                result.skinning_peers[name] = timing
            case "probe", name, _:
                result.probes[name] = min(result.probes.get(name, timing), timing, key=lambda each: each.p50)

    cold = {f"frame.{precision}": steps[precision, widest].step for precision in PRECISIONS}
    cold |= {f"networks.{precision}": steps[precision, widest].run_networks for precision in PRECISIONS}
    cold |= {f"networks.{name}": network_calls[name] for name in COLD_PEERS if name in network_calls}
    result.cold = time_in_turns(cold, rounds=cold_rounds, repeats=1, before_each=_cache_flusher())
    for precision in PRECISIONS:
        result.errors[precision] = _errors(case, evaluators[precision, widest])
    return result


def _body_calls(case: BenchmarkCase, first: int) -> dict[tuple, Callable[[], object]]:
    """Frames of several bodies, in a batch and with an evaluator each, from pose `first` on."""
    poses = (first + np.arange(len(case.bodies))) % len(case.joint_positions)
    positions, gravity = case.joint_positions[poses], case.gravity[poses]
    calls: dict[tuple, Callable[[], object]] = {}
    for precision in PRECISIONS:
        for count in BATCH_SIZES:
            batch = NativeEvaluatorBatch(case.bodies[:count], precision=precision)
            out = np.empty((count, len(case.bound.vertices), 6), dtype=np.float32)
            batch.bind(positions[:count].copy(), gravity[:count].copy(), out)
            calls["batch", precision, count] = batch.step
        steps = []
        for k, bound in enumerate(case.bodies):
            out = np.empty((len(bound.vertices), 6), dtype=np.float32)
            evaluator = NativeEvaluator(bound, precision=precision)
            steps.append(evaluator.bind_step(positions[k].copy(), gravity[k].copy(), out).step)
        calls["singles", precision] = lambda steps=steps: [step() for step in steps]
    return calls


def _probes(result: CaseResult, level: str) -> dict[tuple[str, bool], Callable[[], object]]:
    """By name and whether memory is fetched ahead of time: what counts is the faster way."""
    sizes = {"l2": L2_BYTES, "l3": L3_BYTES}
    sizes |= {f"read_{name}": bytes_each * result.weight_count for name, bytes_each in BYTES_A_WEIGHT.items()}
    sizes["read_int8"] += result.case.bound.deformer_layers[0][0].size
    probes = {name: _native.MachineProbe(size, level) for name, size in sizes.items()}
    calls: dict[tuple[str, bool], Callable[[], object]] = {
        (name, fetch_ahead): partial(probe.read, fetch_ahead)
        for name, probe in probes.items()
        for fetch_ahead in (False, True)
    }
    result.amounts = {name: call() for (name, _), call in calls.items()}
    calls["fma", False] = lambda: probes["l2"].multiply_add(MULTIPLY_ADD_ROUNDS)
    result.amounts["fma"] = calls["fma", False]()
    memory = _native.MachineProbe(MEMORY_BYTES, level)
    result.amounts["memory"] = memory.read(True)
    timings = time_in_turns({way: partial(memory.read, way) for way in (False, True)}, rounds=3, repeats=1)
    result.probes["memory"] = min(timings.values(), key=lambda timing: timing.p50)
    return calls


def _cache_flusher() -> Callable[[], None]:
    """Writes to four times as much memory as last-level caches usually hold for a core."""
    filler = np.zeros(128 << 17)

    def flush() -> None:
        np.add(filler, 1, out=filler)

    return flush


def _errors(case: BenchmarkCase, evaluator: NativeEvaluator) -> dict[str, float]:
    """Against the float64 reference, over the case's poses: millimetres, relative error of the networks' output."""
    reference = ReferenceEvaluator(case.bound)
    out, expected = np.empty((2, len(case.bound.vertices), 6), dtype=np.float32)
    distances, strains = [], []
    for pose, gravity in zip(case.joint_positions, case.gravity):
        evaluator.evaluate(pose, gravity, out)
        reference.evaluate(pose, gravity, expected)
        distances.append(np.linalg.norm(out[:, :3].astype(np.float64) - expected[:, :3], axis=1))
        if case.garment is not None:
            strains.append([float(edge_strain(case.garment, vertices[:, :3])) for vertices in (out, expected)])
    networks = network_case(case.bound, pose, gravity)
    corrections = evaluator.corrections().reshape(networks.expected.shape)
    errors = {
        "networks.relative": float(np.linalg.norm(corrections - networks.expected) / np.linalg.norm(networks.expected)),
        "vertices.mm.mean": 1e3 * float(np.mean(distances)),
        "vertices.mm.p99": 1e3 * float(np.percentile(distances, 99)),
        "vertices.mm.max": 1e3 * float(np.max(distances)),
    }
    if strains:
        errors["edge_strain.percent.change"] = float(np.subtract(*np.mean(strains, axis=0)))
    return errors
