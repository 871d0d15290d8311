"""One case of the benchmark: the native evaluator in every precision, and its peers, in turns."""

from __future__ import annotations

from dataclasses import astuple
from functools import partial

import numpy as np

from physkin_bench.cases import BenchmarkCase, skinning_case
from physkin_bench.litert_networks import network_case, weight_count
from physkin_bench.peers import NETWORK_PEERS, SKINNING_PEERS, prepare_peers
from physkin_core.bench import STAGES, stage_bytes, stage_frames, time_cold, time_in_turns, timing_keys
from physkin_core.native_module import native
from physkin_core.runtime.evaluator import PRECISIONS, Evaluator, supported_instruction_sets
from physkin_core.separation.limb_separator import SeparationSettings

__all__ = ["compared_levels", "measure_case"]

EMPTIED_ROUNDS = 30
"""Most turns with emptied caches, which take long."""


def compared_levels() -> list[str]:
    """AVX2, AVX-VNNI and the widest instruction set: they are timed cold, and compared with peers, which choose by
    themselves."""
    levels = supported_instruction_sets()
    return [level for level in levels if level in ("v3", "v3_vnni", levels[-1])]


def measure_case(case: BenchmarkCase, *, rounds: int) -> dict[str, object]:
    """Check and time everything there is for a case. rounds: turns that each thing to time gets.

    Returns the keys of docs/notebook/benchmark.md, of which times are microseconds.
    """
    middle = len(case.joint_positions) // 2
    bound, pose, inputs = case.bound, case.joint_positions[middle].copy(), case.inputs[middle].copy()
    found, levels = stage_frames(bound, pose, inputs), supported_instruction_sets()
    evaluators = {p: found[f"{p}.{levels[-1]}"][0] for p in PRECISIONS}
    calls = {f"{name}.{stage}": getattr(found[name][1], method) for name in found for stage, method in STAGES.items()}
    if case.limbs is not None:
        shape, arms_down = case.limbs
        for level in levels:
            separator = native.LimbSeparator(shape, *astuple(SeparationSettings()), level)
            calls[f"separate_limbs.{level}"] = partial(separator.separate, arms_down, np.empty_like(arms_down))
    networks = network_case(bound, pose, inputs)
    skinning = skinning_case(bound, evaluators["fp32"].node_transforms(), evaluators["fp32"].detail_offsets())
    missing = {}
    for kind, engines, task in (("networks", NETWORK_PEERS, networks), ("skinning", SKINNING_PEERS, skinning)):
        built, left_out = prepare_peers(engines, task, task.expected)
        calls |= {f"peers.{kind}.{name}": call for name, call in built.items()}
        missing |= {f"{kind}.{name}": reason for name, reason in left_out.items()}
    timings = time_in_turns(calls, rounds=rounds)
    names = [name for name in calls if name.startswith("peers.networks.")]
    names += [
        f"{p}.{level}.{stage}" for p in PRECISIONS for level in compared_levels() for stage in ("networks", "frame")
    ]
    timings |= time_cold({name: calls[name] for name in names}, rounds=rounds)
    filler = np.zeros(128 << 17)  # four times what last-level caches usually hold for a core
    flush = partial(np.add, filler, 1, out=filler)
    emptied = {f"emptied.{name}": calls[name] for name in names}
    timings |= time_in_turns(emptied, rounds=min(rounds, EMPTIED_ROUNDS), repeats=1, before_each=flush)

    figures: dict[str, object] = {"model": case.name, "vertices": len(bound.vertices)}
    figures |= {"detail_nodes": len(skinning.detail_offsets), "network_weights": weight_count(bound)}
    figures |= timing_keys(timings) | stage_bytes(found)
    for precision in ("bf16", "int8"):
        errors = _errors(case, evaluators["fp32"], evaluators[precision])
        figures |= {f"error.{precision}.vertices.mm.{name}": value for name, value in errors.items()}
    return figures | {"missing": missing}


def _errors(case: BenchmarkCase, exact: Evaluator, evaluator: Evaluator) -> dict[str, float]:
    """[mm] Of rounded network weights, over the case's poses."""
    out, expected = np.empty((2, len(case.bound.vertices), 6), dtype=np.float32)
    distances = []
    for pose, inputs in zip(case.joint_positions, case.inputs):
        evaluator.evaluate(pose, inputs, [out])
        exact.evaluate(pose, inputs, [expected])
        distances.append(1e3 * np.linalg.norm(out[:, :3].astype(np.float64) - expected[:, :3], axis=1))
    figures = {"mean": np.mean(distances), "p99": np.percentile(distances, 99), "max": np.max(distances)}
    return {name: float(value) for name, value in figures.items()}
