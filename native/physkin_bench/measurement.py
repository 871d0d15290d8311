"""One case of the benchmark: the native evaluator in every precision, its peers, and the machine's limits, in turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple
from functools import partial

import numpy as np

from physkin_bench.cases import BenchmarkCase, skinning_case
from physkin_bench.network_case import network_case
from physkin_bench.peers import NETWORK_PEERS, SKINNING_PEERS, prepare_peers
from physkin_core.bench import STAGES, bound_frame, stage_frames, time_in_turns, timing_keys
from physkin_core.native_module import native
from physkin_core.quality import edge_strain
from physkin_core.runtime.evaluator import PRECISIONS, Evaluator, supported_instruction_sets
from physkin_core.separation.limb_separator import SeparationSettings

__all__ = ["measure_case"]

BYTES_A_WEIGHT = {"fp32": 4, "bf16": 2, "int8": 1}
"""Bytes of a network weight; in int8 the first layers of both networks have as many as in bf16."""
COLD_ROUNDS = 30
"""Most turns with cold caches, which take long."""
MULTIPLY_ADD_ROUNDS = 5000
BLOCK = 16
"""Vertices that share one union of garment nodes."""
POSITION_MULTIPLY_ADDS, NORMAL_MULTIPLY_ADDS = 9, 27
"""A vertex's, that apply a blended matrix to a position, and its cofactors to a normal."""


def measure_case(case: BenchmarkCase, *, rounds: int) -> dict[str, object]:
    """Check and time everything there is for a case. rounds: turns that each thing to time gets.

    Returns the keys of docs/notebook/benchmark.md, of which times are microseconds.
    """
    middle = len(case.joint_positions) // 2
    bound, pose, inputs = case.bound, case.joint_positions[middle].copy(), case.inputs[middle].copy()
    found, levels = stage_frames(bound, pose, inputs), supported_instruction_sets()
    evaluators, steps = ({p: found[f"{p}.{levels[-1]}"][k] for p in PRECISIONS} for k in (0, 1))
    calls = {f"{name}.{stage}": getattr(found[name][1], method) for name in found for stage, method in STAGES.items()}
    for level in levels:
        if len(bound.faces):
            normals = Evaluator([bound], instruction_set=level)
            calls[f"face_normals.{level}"] = bound_frame(normals, bound, pose, inputs).compute_normals
        if case.limbs is not None:
            shape, arms_down = case.limbs
            separator = native.LimbSeparator(shape, *astuple(SeparationSettings()), level)
            calls[f"separate_limbs.{level}"] = partial(separator.separate, arms_down, np.empty_like(arms_down))
    networks = network_case(bound, pose, inputs[0, :3], evaluators["fp32"])
    skinning = skinning_case(bound, evaluators["fp32"].node_transforms(), evaluators["fp32"].features())
    missing = {}
    for kind, engines, task in (("networks", NETWORK_PEERS, networks), ("skinning", SKINNING_PEERS, skinning)):
        built, left_out = prepare_peers(engines, task, task.expected)
        calls |= {f"peers.{kind}.{name}": call for name, call in built.items()}
        missing |= {f"{kind}.{name}": reason for name, reason in left_out.items()}
    first_layers = bound.pose_layers[0][0].size + bound.deformer_layers[0][0].size
    probes, amount = _probes(networks.weight_count, first_layers, levels[-1])
    timings = time_in_turns(calls | probes, rounds=rounds)
    cold = {
        f"cold.{stage}.{p}": getattr(steps[p], STAGES[stage]) for stage in ("frame", "networks") for p in PRECISIONS
    }
    cold |= {f"cold.{name}": call for name, call in calls.items() if name.startswith("peers.networks.litert")}
    filler = np.zeros(128 << 17)  # four times what last-level caches usually hold for a core
    flush = partial(np.add, filler, 1, out=filler)
    limits = {name: timings.pop(name) for name in probes}
    timings |= time_in_turns(cold, rounds=min(rounds, COLD_ROUNDS), repeats=1, before_each=flush)

    figures: dict[str, object] = {"model": case.name, "vertices": len(bound.vertices)}
    figures["features"] = len(skinning.features)
    figures["network_weights"] = networks.weight_count
    figures |= timing_keys(timings)
    blocks = -(-len(bound.vertices) // BLOCK)
    applied = POSITION_MULTIPLY_ADDS + (0 if skinning.has_normals_of_faces else NORMAL_MULTIPLY_ADDS)
    multiply_adds = evaluators["fp32"].skinning_multiply_adds() + BLOCK * applied * blocks
    floors = {"fp32.skinning": limits["multiply_add"].p50 * multiply_adds / amount}
    floors |= {f"{p}.networks": min(limits[f"read.{p}.{way}"].p50 for way in (False, True)) for p in PRECISIONS}
    for name, floor in floors.items():
        precision, stage = name.split(".")
        figures[f"floor.{name}.us"] = floor
        figures[f"floor.{name}.share"] = floor / timings[f"{precision}.{levels[-1]}.{stage}"].p50
    for precision in ("bf16", "int8"):
        errors = _errors(case, evaluators["fp32"], evaluators[precision])
        figures |= {f"error.{precision}.{figure}": value for figure, value in errors.items()}
    return figures | {"missing": missing}


def _probes(weights: int, first_layers: int, level: str) -> tuple[dict[str, Callable[[], object]], int]:
    """What the machine can do at best: reading as many bytes as the network weights have, in two ways, and multiplying.

    Returns calls, and how many multiply-adds the last one does.
    """
    calls: dict[str, Callable[[], object]] = {}
    for precision, size in BYTES_A_WEIGHT.items():
        probe = native.MachineProbe(size * weights + (first_layers if precision == "int8" else 0), level)
        calls |= {f"read.{precision}.{way}": partial(probe.read, way) for way in (False, True)}
    calls["multiply_add"] = partial(probe.multiply_add, MULTIPLY_ADD_ROUNDS)
    return calls, calls["multiply_add"]()


def _errors(case: BenchmarkCase, exact: Evaluator, evaluator: Evaluator) -> dict[str, float]:
    """Of rounded network weights, over the case's poses: millimetres, and what is added to the edge strain."""
    out, expected = np.empty((2, len(case.bound.vertices), 6), dtype=np.float32)
    distances, strains = [], []
    for pose, inputs in zip(case.joint_positions, case.inputs):
        evaluator.evaluate(pose, inputs, [out])
        exact.evaluate(pose, inputs, [expected])
        distances.append(1e3 * np.linalg.norm(out[:, :3].astype(np.float64) - expected[:, :3], axis=1))
        if case.garment is not None:
            strains.append(float(edge_strain(case.garment, out[:, :3]) - edge_strain(case.garment, expected[:, :3])))
    figures = {"mean": np.mean(distances), "p99": np.percentile(distances, 99), "max": np.max(distances)}
    errors = {f"vertices.mm.{name}": float(value) for name, value in figures.items()}
    return errors | ({"edge_strain.points": float(np.mean(strains))} if strains else {})
