"""What the native evaluator accepts as output, and what it rejects."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.lib.stride_tricks import as_strided

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


@pytest.mark.parametrize(
    "view",
    [
        lambda a: a[:, :6],
        lambda a: a[:, 2:5],
        lambda a: a[::-1, 1:7],
        lambda a: a.reshape(-1)[: len(a) * 6].reshape(-1, 6),
        lambda a: a.reshape(-1)[: len(a) * 3].reshape(-1, 3),
    ],
)
@pytest.mark.parametrize("offset", [0, 1, 2, 61])
def test_rows_may_lie_anywhere(frame, offset, view):
    """Any distance apart, backwards, at any byte, as in a serialised message; only what is addressed is written."""
    evaluator, garment, pose, expected = frame
    message = bytearray(offset + 4 * 9 * len(garment.vertices))
    rows = np.frombuffer(message, dtype=np.float32, offset=offset).reshape(-1, 9)
    rows[:] = 7
    out = view(rows)
    evaluator.evaluate(*pose, out)
    assert np.array_equal(out, expected[:, : out.shape[1]])
    assert (rows == 7).sum() == rows.size - out.size and not any(message[:offset])


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
    "make_out, message",
    [
        (lambda n: np.zeros((n, 6)), None),
        (lambda n: np.zeros((n, 6), dtype=np.int32), None),
        (lambda n: np.zeros((n, 6), dtype=">f4"), None),
        (lambda n: read_only(np.zeros((n, 6), dtype=np.float32)), None),
        (lambda n: np.zeros(6 * n, dtype=np.float32), None),
        (lambda n: bytearray(24 * n), None),
        (lambda n: [[0.0] * 6] * n, None),
        (lambda n: np.zeros((n - 1, 6), np.float32), "out has shape"),
        (lambda n: np.zeros((n + 1, 6), np.float32), "out has shape"),
        (lambda n: np.zeros((n, 4), np.float32), "out has shape"),
        (lambda n: np.zeros((n, 12), np.float32)[:, ::2], "row of out must be contiguous"),
        (lambda n: np.zeros((6, n), np.float32).T, "row of out must be contiguous"),
        (lambda n: as_strided(np.zeros(6 * n, np.float32), (n, 6), (8, 4)), "rows of out overlap"),
    ],
)
def test_other_outputs_are_refused(frame, make_out, message):
    """TypeError where it is no writable 2-D float32 array, ValueError for another shape or rows that lie badly."""
    evaluator, garment, pose, _ = frame
    out = make_out(len(garment.vertices))
    error = (TypeError, "writable and 2-D; got .*out ") if message is None else (ValueError, message)
    with pytest.raises(error[0], match=error[1]):
        evaluator.evaluate(*pose, out)
    with pytest.raises(error[0], match=error[1]):
        evaluator.skin(evaluator.node_transforms(), out)
    assert not np.any(out if message else 0)


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
        (lambda g: dict(bone_parents=changed(g.bone_parents, 2, -2)), r"bone_parents\[2\].* is -2"),
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
        (lambda g: dict(faces=np.array([[0, 1, 2], [3, 50, 4]], np.int32)), r"faces\[4\].* is 50"),
        (lambda g: dict(faces=np.array([[0, -1, 2]], np.int32)), r"faces\[1\].* is -1"),
    ],
)
def test_malformed_garment_raises_value_error(change, message, make_garment):
    garment = make_garment(np.random.default_rng(14))
    NativeEvaluator(garment)
    with pytest.raises(ValueError, match=message):
        NativeEvaluator(replace(garment, **change(garment)))


# --- Choice of the instruction set ---


@pytest.mark.parametrize("level", ["baseline", "v3", "v4", "v4_vnni", "", None, "v9"])
def test_environment_forces_the_instruction_set(level, make_garment, monkeypatch):
    """Without it, the widest supported one."""
    garment, supported = make_garment(np.random.default_rng(0)), supported_instruction_sets()
    monkeypatch.delenv("PHYSKIN_NATIVE_ISA", raising=False)
    if level is not None:
        monkeypatch.setenv("PHYSKIN_NATIVE_ISA", level)
    if level and level not in supported:
        with pytest.raises(ValueError, match=rf"'{level}' \(from PHYSKIN_NATIVE_ISA\)"):
            NativeEvaluator(garment)
    else:
        assert NativeEvaluator(garment).instruction_set == (level or supported[-1])
    with pytest.raises(ValueError, match="'avx' is unknown or not supported .* supports baseline"):
        NativeEvaluator(garment, instruction_set="avx")
