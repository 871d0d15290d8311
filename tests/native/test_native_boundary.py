"""What the native evaluator accepts as output, and what it rejects."""

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


# --- A frame: never silently lost, never half written. Layouts: test_any_step.py, test_draper.py. ---


def test_skinning_alone_checks_its_arrays(frame):
    """As a frame does."""
    evaluator, _, _, out = frame
    transforms = evaluator.node_transforms()
    for wrong, error in ((out.astype(np.float64), TypeError), (out[:-1], ValueError), (out[:, ::2], ValueError)):
        with pytest.raises(error):
            evaluator.skin(transforms, wrong)
    for bad in (np.nan, np.inf, 1e30):
        transforms[3, 1, 2] = bad
        with pytest.raises(ValueError, match=r"node_transforms\[42\]"):
            evaluator.skin(transforms, out)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_input_that_is_not_finite_raises_and_writes_nothing(frame, bad):
    """Every joint and every component of gravity is named; the last frame stays readable. Doubles may be too large."""
    evaluator, _, (positions, gravity), expected = frame
    nodes, out = evaluator.node_transforms(), np.full_like(expected, 7.0)
    for name, source in (("joint_positions", positions), ("gravity", gravity)):
        for index in range(len(source)):
            inputs = {"joint_positions": positions.astype(np.float64), "gravity": np.repeat(gravity, 2)[::2]}
            if bad == 1e300:
                inputs["gravity"] = gravity.astype(np.float64)
            inputs[name][index] = bad
            with pytest.raises(ValueError, match=rf"{name}\[{index}\] is .*finite"):
                evaluator.evaluate(**inputs, out=out)
    assert (out == 7.0).all()
    assert np.array_equal(evaluator.node_transforms(), nodes)
    evaluator.evaluate(np.repeat(positions, 3)[::3], gravity.astype(np.float64), out)  # any stride, float64
    assert np.array_equal(out, expected)
    for q, g, error in (
        (np.zeros(8), np.zeros(3), ValueError),
        (np.zeros((7, 1)), np.zeros(3), ValueError),
        (np.zeros(7), np.zeros(2), ValueError),
        (np.zeros(7), np.zeros(4), ValueError),
        (np.zeros(7, dtype=int), np.zeros(3), TypeError),
        ([0.0] * 7, np.zeros(3), TypeError),
        (np.zeros(7), None, TypeError),
    ):
        with pytest.raises(error):
            evaluator.evaluate(q, g, out)


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
            lambda g: dict(deformer_layers=((g.deformer_layers[0][0], g.dof_rest), *g.deformer_layers[1:])),
            "bias must be",
        ),
        (lambda g: dict(activation="tanh"), "activation is 'tanh'"),
        (lambda g: dict(node_twist=g.node_twist[1:]), "node_twist has"),
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
