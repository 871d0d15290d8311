"""What the native evaluator accepts as output, and what it rejects."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from physkin_core.runtime.native_evaluator import NativeEvaluator, supported_instruction_sets


@pytest.fixture
def frame(make_garment, make_pose):
    """An evaluator, its garment, a pose, and that pose's frame (n, 6)."""
    rng = np.random.default_rng(11)
    garment = make_garment(rng)
    evaluator = NativeEvaluator(garment)
    pose = make_pose(rng, garment)
    out = np.empty((len(garment.vertices), 6), dtype=np.float32)
    evaluator.evaluate(*pose, out)
    assert np.isfinite(out).all()
    return evaluator, garment, pose, out


# --- Layouts of the output ---


@pytest.mark.parametrize("columns", [3, 6])
@pytest.mark.parametrize("width", [6, 7, 8, 32])
def test_rows_may_be_any_distance_apart(frame, columns, width):
    """Only the addressed columns are written."""
    evaluator, garment, pose, expected = frame
    buffer = np.full((len(garment.vertices), width), 7.0, dtype=np.float32)
    evaluator.evaluate(*pose, buffer[:, :columns])
    assert np.array_equal(buffer[:, :columns], expected[:, :columns])
    assert (buffer[:, columns:] == 7.0).all()


def test_rows_may_run_backwards(frame):
    evaluator, _, pose, expected = frame
    out = np.empty_like(expected)
    evaluator.evaluate(*pose, out[::-1])
    assert np.array_equal(out[::-1], expected)


@pytest.mark.parametrize("offset", [1, 2, 3, 61])
def test_output_may_lie_at_any_byte(frame, offset):
    """A serialised message puts its data where its header ends."""
    evaluator, _, pose, expected = frame
    message = bytearray(offset + expected.nbytes)
    out = np.frombuffer(message, dtype=np.float32, offset=offset).reshape(expected.shape)
    evaluator.evaluate(*pose, out)
    assert np.array_equal(out, expected) and not any(message[:offset])


def test_inputs_may_be_double_or_strided(frame):
    evaluator, _, (positions, gravity), expected = frame
    out = np.empty_like(expected)
    for q, g in [
        (positions.astype(np.float64), gravity.astype(np.float64)),
        (np.repeat(positions, 3)[::3], gravity[::-1].copy()[::-1]),
    ]:
        out[:] = np.nan
        evaluator.evaluate(q, g, out)
        assert np.array_equal(out, expected)


# --- Rejections of a frame: never silently lost, never half written ---


def read_only(array):
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    "make_out",
    [
        lambda n: np.zeros((n, 6)),
        lambda n: np.zeros((n, 6), dtype=np.float16),
        lambda n: np.zeros((n, 6), dtype=np.int32),
        lambda n: np.zeros((n, 6), dtype=">f4"),
        lambda n: read_only(np.zeros((n, 6), dtype=np.float32)),
        lambda n: np.zeros(6 * n, dtype=np.float32),
        lambda n: bytearray(24 * n),
        lambda n: [[0.0] * 6] * n,
    ],
)
def test_other_outputs_raise_type_error(frame, make_out):
    evaluator, garment, pose, _ = frame
    with pytest.raises(TypeError, match="writable and 2-D; got .*out "):
        evaluator.evaluate(*pose, make_out(len(garment.vertices)))
    with pytest.raises(TypeError, match="writable and 2-D; got .*out "):
        evaluator.skin(evaluator.node_transforms(), make_out(len(garment.vertices)))


@pytest.mark.parametrize(
    "make_out, message",
    [
        (lambda n: np.zeros((n - 1, 6), np.float32), "out has shape"),
        (lambda n: np.zeros((n + 1, 6), np.float32), "out has shape"),
        (lambda n: np.zeros((n, 4), np.float32), "out has shape"),
        (lambda n: np.zeros((n, 12), np.float32)[:, ::2], "row of out must be contiguous"),
        (lambda n: np.zeros((6, n), np.float32).T, "row of out must be contiguous"),
    ],
)
def test_other_shapes_raise_value_error(frame, make_out, message):
    evaluator, garment, pose, _ = frame
    out = make_out(len(garment.vertices))
    with pytest.raises(ValueError, match=message):
        evaluator.evaluate(*pose, out)
    assert not out.any()


def test_overlapping_rows_are_rejected(frame):
    evaluator, garment, pose, _ = frame
    n = len(garment.vertices)
    rows = np.lib.stride_tricks.as_strided(np.zeros(6 * n, np.float32), (n, 6), (8, 4))
    with pytest.raises(ValueError, match="rows of out overlap"):
        evaluator.evaluate(*pose, rows)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_input_that_is_not_finite_raises_and_writes_nothing(frame, bad, dtype):
    """Every joint and every component of gravity is named; the last frame stays readable."""
    evaluator, _, (positions, gravity), expected = frame
    nodes = evaluator.node_transforms()
    out = np.full_like(expected, 7.0)
    for name, source in (("joint_positions", positions), ("gravity", gravity)):
        for index in range(len(source)):
            inputs = {"joint_positions": positions.astype(dtype), "gravity": gravity.astype(dtype)}
            inputs[name][index] = bad
            with pytest.raises(ValueError, match=rf"{name}\[{index}\] is .*finite"):
                evaluator.evaluate(**inputs, out=out)
    assert (out == 7.0).all()
    assert np.array_equal(evaluator.node_transforms(), nodes)


def test_joint_position_beyond_float32_raises(frame):
    evaluator, _, (positions, gravity), expected = frame
    positions = positions.astype(np.float64)
    positions[2] = 1e300
    with pytest.raises(ValueError, match=r"joint_positions\[2\]"):
        evaluator.evaluate(positions, gravity, np.empty_like(expected))


@pytest.mark.parametrize("level", supported_instruction_sets())
@pytest.mark.parametrize("activation", ["silu", "relu"])
def test_networks_that_overflow_raise_and_write_nothing(activation, level, make_garment, make_pose):
    """Infinities and NaN inside the networks survive both activations up to the check."""
    rng = np.random.default_rng(12)
    garment = make_garment(rng, activation=activation, deformer_widths=(12,) * 12)
    for weights, _ in garment.deformer_layers:
        weights *= np.float32(3e4)
    evaluator = NativeEvaluator(garment, instruction_set=level)
    out = np.full((len(garment.vertices), 6), 7.0, dtype=np.float32)
    with pytest.raises(ValueError, match="node deformer output"):
        evaluator.evaluate(*make_pose(rng, garment), out)
    assert (out == 7.0).all() and not evaluator.node_transforms().any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_node_transforms_that_are_not_finite_raise(frame, bad):
    evaluator, _, _, expected = frame
    transforms = evaluator.node_transforms()
    transforms[3, 1, 2] = bad
    with pytest.raises(ValueError, match=r"node_transforms\[42\]"):
        evaluator.skin(transforms, np.empty_like(expected))


@pytest.mark.parametrize(
    "positions, gravity, error",
    [
        (np.zeros(8), np.zeros(3), ValueError),
        (np.zeros((7, 1)), np.zeros(3), ValueError),
        (np.zeros(7), np.zeros(4), ValueError),
        (np.zeros(7, dtype=int), np.zeros(3), TypeError),
        ([0.0] * 7, np.zeros(3), TypeError),
        (np.zeros(7), None, TypeError),
    ],
)
def test_other_inputs_are_rejected(frame, positions, gravity, error):
    evaluator, _, _, expected = frame
    with pytest.raises(error):
        evaluator.evaluate(positions, gravity, np.empty_like(expected))


def test_vanishing_directions_do_not_make_nan(make_garment, make_pose):
    """A zero rest normal stays zero; a correction without direction collapses its garment node, finitely."""
    rng = np.random.default_rng(13)
    garment = make_garment(rng, nodes=1, influences=1)
    garment.normals[4] = 0.0
    evaluator = NativeEvaluator(garment)
    out = np.empty((len(garment.vertices), 6), dtype=np.float32)
    evaluator.evaluate(*make_pose(rng, garment), out)
    assert np.isfinite(out).all() and not out[4, 3:].any()
    weights, bias = garment.deformer_layers[-1]
    weights[:], bias[:] = 0.0, 0.0
    bias[0] = -1.0  # e1 + a = 0
    evaluator = NativeEvaluator(garment)
    evaluator.evaluate(*make_pose(rng, garment), out)
    assert np.isfinite(out).all()


# --- Rejections of a garment ---


def changed(array, index, value):
    copy = array.copy()
    copy[index] = value
    return copy


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda g: dict(bone_parents=changed(g.bone_parents, 2, 2)), r"bone_parents\[2\] is 2"),
        (lambda g: dict(bone_parents=changed(g.bone_parents, 2, -2)), r"bone_parents\[2\] is -2"),
        (lambda g: dict(dof_bone=changed(g.dof_bone, 0, 5)), r"dof_bone\[0\].* is 5"),
        (lambda g: dict(node_bone=changed(g.node_bone, 1, -1)), r"node_bone\[1\].* is -1"),
        (lambda g: dict(deformer_bones=changed(g.deformer_bones, 1, 9)), r"deformer_bones\[1\].* is 9"),
        (lambda g: dict(influence_nodes=changed(g.influence_nodes, (3, 1), 6)), r"influence_nodes\[10\].* is 6"),
        (lambda g: dict(dof_upper=g.dof_lower), "must be above its lower limit"),
        (lambda g: dict(vertices=changed(g.vertices, (0, 1), np.nan)), r"vertices\[1\].* is nan"),
        (lambda g: dict(influence_weights=changed(g.influence_weights, (0, 0), np.inf)), "influence_weights.* is inf"),
        (lambda g: dict(vertices=g.vertices.astype(np.float64)), "vertices must be a C-contiguous float32"),
        (lambda g: dict(vertices=np.asfortranarray(g.vertices)), "vertices must be a C-contiguous float32"),
        (lambda g: dict(normals=g.normals[:-1]), r"normals must be .* of shape \(50, 3\)"),
        (lambda g: dict(node_bone=g.node_bone.astype(np.int64)), "node_bone must be a C-contiguous int32"),
        (lambda g: dict(influence_weights=g.influence_weights[:, :2].copy()), r"of shape \(50, 3\)"),
        (lambda g: dict(vertices=g.vertices[:0], normals=g.normals[:0]), "influence_nodes"),
        (lambda g: dict(pose_layers=()), "pose_layers is empty"),
        (lambda g: dict(pose_layers=g.pose_layers[1:]), r"pose_layers\[0\] has 16 inputs; expected 10"),
        (lambda g: dict(pose_layers=g.pose_layers[:-1]), "pose_layers give 16 values; expected .* 24 hidden"),
        (lambda g: dict(deformer_layers=g.deformer_layers[:-1]), "deformer_layers|pose_layers"),
        (
            lambda g: dict(deformer_layers=(*g.deformer_layers[:-1], tuple(a[:-1] for a in g.deformer_layers[-1]))),
            "deformer_layers give 53 values; expected 9 or 12 for each of 6",
        ),
        (
            lambda g: dict(
                deformer_layers=((g.deformer_layers[0][0], np.zeros(3, np.float32)), *g.deformer_layers[1:])
            ),
            r"deformer_layers\[0\] bias must be .* of shape \(12,\)",
        ),
        (lambda g: dict(activation="tanh"), "activation is 'tanh'"),
    ],
)
def test_malformed_garment_raises_value_error(change, message, make_garment):
    garment = make_garment(np.random.default_rng(14))
    NativeEvaluator(garment)
    with pytest.raises(ValueError, match=message):
        NativeEvaluator(replace(garment, **change(garment)))


# --- Choice of the instruction set ---

PRINT_LEVEL = """
import sys, numpy as np
sys.path[:0] = sys.argv[1:]
from conftest import random_bound_garment
from physkin_core.runtime.native_evaluator import NativeEvaluator
print(NativeEvaluator(random_bound_garment(np.random.default_rng(0))).instruction_set)
"""


def run_with_level(level, folder):
    """In an empty folder: Python would take packages from the one it is started in."""
    environment = {k: v for k, v in os.environ.items() if k != "PHYSKIN_NATIVE_ISA"}
    if level is not None:
        environment["PHYSKIN_NATIVE_ISA"] = level
    here = os.path.dirname(__file__)
    command = [sys.executable, "-c", PRINT_LEVEL, here, os.path.dirname(here)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, cwd=folder)


@pytest.mark.parametrize("level", ["baseline", "v3", "v4", "v4_vnni"])
def test_environment_forces_the_instruction_set(level, tmp_path):
    result = run_with_level(level, tmp_path)
    if level in supported_instruction_sets():
        assert result.stdout.strip() == level, result.stderr
    else:
        assert result.returncode != 0 and f"'{level}' (from PHYSKIN_NATIVE_ISA)" in result.stderr


def test_unknown_instruction_set_is_rejected(make_garment, tmp_path):
    result = run_with_level("v9", tmp_path)
    assert result.returncode != 0
    assert "ValueError" in result.stderr and "'v9' (from PHYSKIN_NATIVE_ISA)" in result.stderr
    with pytest.raises(ValueError, match="'avx' is unknown or not supported .* supports baseline"):
        NativeEvaluator(make_garment(np.random.default_rng(0)), instruction_set="avx")


def test_widest_supported_instruction_set_is_the_default(tmp_path):
    for unset in (None, ""):
        assert run_with_level(unset, tmp_path).stdout.strip() == supported_instruction_sets()[-1]
