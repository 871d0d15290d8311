"""The native evaluator agrees with a naive float64 reading of the method, on every instruction set of this CPU."""

from dataclasses import fields, replace

import numpy as np
import pytest
from physkin_core.runtime.native_evaluator import NativeEvaluator, _native, supported_instruction_sets
from physkin_core.runtime.native_skinner import NativeSkinner

from physkin_core.runtime.bound_garment import BoundGarment

pytestmark = pytest.mark.usefixtures("exact_network_weights")

LEVELS = supported_instruction_sets()

ODD = dict(nodes=13, vertices=101, pose_widths=(37, 19, 65), deformer_widths=(33, 7, 50))
SHIPPED = dict(nodes=128, pose_widths=(512,) * 4, deformer_widths=(128,) * 4)
PAPER = SHIPPED | dict(bones=128, dofs=117)
SHAPES = {
    "smallest": dict(bones=1, dofs=0, nodes=1, vertices=1, influences=1, pose_widths=(), deformer_widths=(1,)),
    "no hidden layers": dict(pose_widths=(), deformer_widths=()),
    "odd widths": ODD | dict(bones=7, dofs=11, influences=5),
    "block boundary": dict(vertices=64, influences=2, pose_widths=(32,), deformer_widths=(32, 64)),
    "many influences": dict(nodes=40, vertices=333, influences=16),
    "default rig": SHIPPED | dict(bones=36, dofs=52, vertices=2000, influences=8),
    "paper": PAPER | dict(vertices=1500, influences=4),
}


# --- The oracle: one vertex, one bone, one node at a time, in float64. ---


def oracle_rotation(axis, angle):
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def oracle_bone_transforms(g, q):
    rotations, heads = [], []
    for j, parent in enumerate(g.bone_parents):
        local = np.eye(3)
        for k in range(len(q)):
            if g.dof_bone[k] == j:
                local = local @ oracle_rotation(g.dof_axis[k].astype(float), q[k] - float(g.dof_rest[k]))
        head = g.bone_heads[j].astype(float)
        if parent >= 0:
            head = heads[parent] + rotations[parent] @ (head - g.bone_heads[parent])
            local = rotations[parent] @ local
        rotations.append(local)
        heads.append(head)
    return [np.c_[r, p - r @ h.astype(float)] for r, p, h in zip(rotations, heads, g.bone_heads)]


def oracle_mlp(layers, x, activation, modulation=None):
    at = 0
    for k, (weights, bias) in enumerate(layers):
        x = weights.astype(float) @ x + bias
        if k == len(layers) - 1:
            return x
        if modulation is not None:
            h = len(x)
            x = (1 + modulation[at : at + h]) * x + modulation[at + h : at + 2 * h]
            at += 2 * h
        with np.errstate(over="ignore"):  # exp(-x) may be infinite, which gives the right 0
            x = np.maximum(x, 0) if activation == "relu" else x / (1 + np.exp(-x))


def oracle_correction(c):
    if len(c) == 12:
        return np.eye(3) + c[:9].reshape(3, 3), c[9:]
    first = np.array([1.0, 0, 0]) + c[:3]
    first /= np.linalg.norm(first)
    second = np.array([0, 1.0, 0]) + c[3:6]
    second -= first * (first @ second)
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=1), c[6:]


def oracle_node_transforms(g, q, gravity):
    bones = oracle_bone_transforms(g, q)
    lower, upper = g.dof_lower.astype(float), g.dof_upper.astype(float)
    theta = np.clip((q - (lower + upper) / 2) / ((upper - lower) / 2), -1, 1)
    modulation = oracle_mlp(g.pose_layers, np.r_[theta, gravity], g.activation)
    posed = np.concatenate([bones[j].ravel() for j in g.deformer_bones])
    corrections = oracle_mlp(g.deformer_layers, posed, g.activation, modulation).reshape(len(g.node_bone), -1)
    transforms = []
    for j, position, c in zip(g.node_bone, g.node_positions.astype(float), corrections):
        rotation, translation = bones[j][:, :3], bones[j][:, 3]
        linear, offset = oracle_correction(c)
        transforms.append(np.c_[rotation @ linear, rotation @ offset + rotation @ position + translation])
    return np.array(transforms)


def oracle_skin(g, transforms):
    """Positions (n, 3) and normals (n, 3) before they are normalised, by the inverse transpose of the blend."""
    positions, normals = [], []
    for x, normal, nodes, weights in zip(g.vertices, g.normals, g.influence_nodes, g.influence_weights):
        position, blended = np.zeros(3), np.zeros((3, 3))
        for i, w in zip(nodes, weights.astype(float)):
            linear, translation = transforms[i][:, :3], transforms[i][:, 3]
            position += w * (linear @ (x.astype(float) - g.node_rest[i]) + translation)
            blended += w * linear
        positions.append(position)
        normals.append(np.linalg.det(blended) * np.linalg.solve(blended.T, normal.astype(float)))
    return np.array(positions), np.array(normals)


def assert_agrees(out, positions, blended):
    """Within 1e-5 of the garment's size; normals within 1e-5, more where blending all but cancelled them."""
    scale = max(1.0, np.abs(positions).max())
    assert np.abs(out[:, :3] - positions).max() <= 1e-5 * scale
    if out.shape[1] == 6:
        length = np.linalg.norm(blended, axis=1, keepdims=True)
        assert (np.abs(out[:, 3:] - blended / length) * np.minimum(length, 1.0)).max() <= 1e-5


# --- Agreement ---


def assert_frame_agrees(g, q, gravity, columns=6):
    """Positions, normals and garment node transforms, on every instruction set."""
    transforms = oracle_node_transforms(g, q.astype(float), gravity.astype(float))
    expected = oracle_skin(g, transforms)
    for level in LEVELS:
        evaluator = NativeEvaluator(g, instruction_set=level)
        assert evaluator.instruction_set == level
        out = np.full((len(g.vertices), columns), np.nan, dtype=np.float32)
        evaluator.evaluate(q, gravity, out)
        assert np.abs(evaluator.node_transforms() - transforms).max() <= 1e-5 * max(1.0, np.abs(transforms).max())
        assert_agrees(out, *expected)


@pytest.mark.parametrize("activation, correction_size", [("silu", 9), ("relu", 12)])
@pytest.mark.parametrize("shape", SHAPES)
def test_frame_agrees_with_oracle(shape, activation, correction_size, make_garment, make_pose):
    """With and without normals in the output."""
    rng = np.random.default_rng(list(f"{shape}{activation}{correction_size}".encode()))
    g = make_garment(rng, **{**SHAPES[shape], "activation": activation, "correction_size": correction_size})
    for columns in (6, 3):
        assert_frame_agrees(g, *make_pose(rng, g), columns)


@pytest.mark.parametrize("vertices", [1, 5, 15, 16, 17, 40, 210])
def test_skinning_alone_agrees_with_oracle(vertices, make_garment):
    """A last block of any length; transforms need not be rotations. Positions alone are those written with normals, bit
    for bit. Vertices none of which follows a garment node come to lie at the origin, without normals."""
    rng = np.random.default_rng(vertices)
    g = make_garment(rng, nodes=9, vertices=vertices, influences=1 + vertices % 8)
    unbound = replace(g, influence_weights=np.zeros_like(g.influence_weights))
    transforms = rng.normal(size=(9, 3, 4)).astype(np.float32)
    expected = oracle_skin(g, transforms)
    for level in LEVELS:
        out, positions = np.empty((vertices, 6), dtype=np.float32), np.empty((vertices, 3), dtype=np.float32)
        for rows in (out, positions):
            NativeEvaluator(g, instruction_set=level).skin(transforms, rows)
        assert_agrees(out, *expected)
        np.testing.assert_array_equal(positions, out[:, :3])
        NativeEvaluator(unbound, instruction_set=level).skin(transforms, out)
        np.testing.assert_array_equal(out, 0)


def test_skinning_needs_no_networks(make_garment):
    """`NativeSkinner` gives the evaluator's bits, and checks what it is given."""
    rng = np.random.default_rng(9)
    g = make_garment(rng, nodes=11, vertices=137)
    transforms = rng.normal(size=(11, 3, 4)).astype(np.float32)
    out, expected = np.empty((2, 137, 6), dtype=np.float32)
    NativeEvaluator(g).skin(transforms, expected)
    arrays = [g.vertices, g.normals, g.node_rest, g.influence_nodes, g.influence_weights]
    skinner = NativeSkinner(*arrays)
    skinner.skin(transforms, out)
    assert np.array_equal(out, expected)
    transforms[3, 1, 2] = np.nan
    with pytest.raises(ValueError, match=r"node_transforms\[42\] is nan"):
        skinner.skin(transforms, out)
    with pytest.raises(ValueError, match="node_transforms must have shape"):
        skinner.skin(transforms[1:], out)
    for wrong in (11, -1):
        arrays[3] = g.influence_nodes.copy()
        arrays[3][5, 0] = wrong
        with pytest.raises(ValueError, match="influence_nodes"):
            NativeSkinner(*arrays)


def test_silu_over_its_whole_range(make_garment):
    """Relative error below 1e-6, also where the exponential under- or overflows.

    Each hidden unit's input is its bias and its output goes unchanged into one coordinate of a node's translation.
    """
    inputs = np.r_[np.linspace(-100, 100, 2001), np.logspace(-6, 3, 200), -np.logspace(-6, 5, 202)].astype(np.float32)
    count = len(inputs)
    g = make_garment(
        np.random.default_rng(6), bones=1, dofs=0, nodes=count // 3, pose_widths=(), deformer_widths=(count,)
    )
    for array in (*g.pose_layers[0], *g.deformer_layers[0], g.node_positions):
        array[:] = 0
    g.deformer_layers[0][1][:] = inputs
    output = np.zeros((count // 3, 9, count), dtype=np.float32)
    output[:, 6:] = np.eye(count).reshape(count // 3, 3, count)
    bias = np.zeros(3 * count, dtype=np.float32)
    g = replace(g, deformer_layers=(g.deformer_layers[0], (output.reshape(-1, count), bias)))

    x = inputs.astype(float)
    with np.errstate(over="ignore"):
        expected = x / (1 + np.exp(-x))
    for level in LEVELS:
        evaluator = NativeEvaluator(g, instruction_set=level)
        evaluator.evaluate(np.empty(0), np.array([0.0, 0, -1]), np.empty((len(g.vertices), 3), dtype=np.float32))
        np.testing.assert_allclose(evaluator.node_transforms()[:, :, 3].ravel(), expected, rtol=1e-6, atol=1e-30)


def test_frames_do_not_interact(make_garment, make_pose):
    """One pose, another, and the first again gives the first result bit for bit, whatever became of the garment."""
    rng = np.random.default_rng(7)
    g = make_garment(rng)
    first, second = make_pose(rng, g), make_pose(rng, g)
    evaluators = [NativeEvaluator(g, instruction_set=level) for level in LEVELS]
    frames = np.empty((len(evaluators), 3, len(g.vertices), 6), dtype=np.float32)
    for evaluator, out in zip(evaluators, frames):
        evaluator.evaluate(*first, out[0])
        evaluator.evaluate(*second, out[1])
    for array in (g.vertices, g.bone_heads, g.dof_axis, g.influence_weights, g.pose_layers[0][0]):
        array[:] = np.nan
    for evaluator, (a, b, c) in zip(evaluators, frames):
        evaluator.evaluate(*first, c)
        assert np.array_equal(a, c) and not np.array_equal(a, b)


def test_both_sides_name_the_same_fields():
    """The dataclass and the list that native code reads, checks and loads by."""
    assert sorted(_native.bound_garment_fields()) == sorted(field.name for field in fields(BoundGarment))
