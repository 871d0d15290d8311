"""Network weights in less than fp32 on every instruction set of this CPU, and steps with bound arrays."""

import gc
import tracemalloc

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from reference.frame import ReferenceFrame

from physkin_core.runtime.evaluator import PRECISIONS, supported_instruction_sets

LEVELS = supported_instruction_sets()
ROUNDING = {"fp32": 5e-7, "bf16": 2**-9, "int8": 1 / 127}
"""Relative, a layer: of the network weights; of sums and inputs where those are exact."""
SHAPES = {
    "small": dict(),
    "odd widths": dict(nodes=13, vertices=101, pose_widths=(37, 19, 65), deformer_widths=(33, 7, 50)),
    "narrow last panels": dict(nodes=11, pose_widths=(160, 96), deformer_widths=(224, 130)),
    "paper": dict(bones=128, dofs=117, nodes=128, vertices=300, pose_widths=(512,) * 4, deformer_widths=(128,) * 4),
}


def frame(evaluator, garment, pose):
    (cloud,) = clouds(evaluator, [garment], pose[0], told(pose[1]))
    return cloud


# --- Precision ---


@pytest.mark.parametrize("shape", SHAPES)
def test_networks_agree_with_reference(shape, make_garment, make_pose):
    """Within the rounding of the network weights, layer by layer, in the norm; each output within four times that. Each
    precision gives another frame."""
    rng = np.random.default_rng(list(shape.encode()))
    garment = make_garment(rng, **SHAPES[shape])
    reference = ReferenceFrame([garment])
    layers = len(garment.pose_layers) + len(garment.deformer_layers)
    evaluators = [
        NativeFrame([garment], instruction_set=level, precision=precision)
        for level in LEVELS
        for precision in PRECISIONS
    ]
    for _ in range(2):
        pose = make_pose(rng, garment)
        (cloud,) = clouds(reference, [garment], pose[0], told(pose[1]))
        expected = reference.corrections()
        typical, largest = np.sqrt((expected**2).mean()), np.abs(expected).max()
        size = max(np.abs(cloud[:, :3]).max(), 1)
        frames = set()
        for evaluator in evaluators:
            out = frame(evaluator, garment, pose)
            allowed = layers * ROUNDING[evaluator.precision]
            error = np.abs(evaluator.corrections().reshape(expected.shape) - expected)
            assert np.sqrt((error**2).mean()) <= allowed * typical
            assert error.max() <= 4 * allowed * largest
            assert np.abs(out[:, :3] - cloud[:, :3]).max() <= 4 * allowed * size
            frames.add(out.tobytes())
        assert len(frames) >= len(PRECISIONS)


@pytest.mark.parametrize("level", LEVELS)
def test_int8_of_whole_numbers_is_exact(level, make_garment):
    """Network weights that are whole numbers up to 127, and inputs that are 0 or 40, of which SiLU leaves all or none,
    lose nothing."""
    rng = np.random.default_rng(22)
    garment = make_garment(rng, nodes=40, pose_widths=(), deformer_widths=(70,))
    for network in (garment.pose_layers, garment.deformer_layers):
        network[0][0][:] = network[0][1][:] = 0
    garment.deformer_layers[0][1][:] = inputs = 40 * rng.integers(0, 2, size=70)
    weight, bias = garment.deformer_layers[1]
    weight[:] = rng.integers(-127, 128, size=weight.shape)
    weight[:, 0] = 127
    bias[:] = 0
    evaluator = NativeFrame([garment], instruction_set=level, precision="int8")
    frame(evaluator, garment, (garment.dof_rest, (0, 0, -1)))
    np.testing.assert_allclose(evaluator.corrections().ravel(), weight.astype(float) @ inputs, atol=0.04)


@pytest.mark.parametrize("level", LEVELS)
def test_int8_keeps_the_layer_that_reads_bone_transforms(level, make_garment, make_pose):
    """It is in bf16, bit for bit, and the others are not."""
    rng = np.random.default_rng(27)
    for widths, same in (((), True), ((40,), False)):
        garment = make_garment(rng, nodes=12, pose_widths=(), deformer_widths=widths)
        pose = make_pose(rng, garment)
        evaluators = [NativeFrame([garment], instruction_set=level, precision=name) for name in ("bf16", "int8")]
        for evaluator in evaluators:
            frame(evaluator, garment, pose)
        assert np.array_equal(*(evaluator.corrections() for evaluator in evaluators)) == same


@pytest.mark.parametrize("level", [level for level in LEVELS if level.endswith("_vnni")])
@pytest.mark.parametrize("shape", SHAPES)
def test_int8_sums_are_the_same_from_bytes_as_from_16_bit_integers(shape, level, make_garment, make_pose):
    """Both are exact, and nothing else differs between the two levels of one register width."""
    rng = np.random.default_rng(list(f"bytes {shape}".encode()))
    garment = make_garment(rng, **SHAPES[shape])
    pose = make_pose(rng, garment)
    frames = [
        frame(NativeFrame([garment], instruction_set=level, precision="int8"), garment, pose)
        for level in (level.removesuffix("_vnni"), level)
    ]
    assert np.array_equal(*frames)


@pytest.mark.skipif("v3" not in LEVELS, reason="this CPU has no AVX2")
def test_int8_layers_are_the_same_at_either_register_width(make_garment):
    """Sums are exact and what surrounds them is computed lane by lane. First layers are left to their biases: register
    width decides which of their network weights are rounded together."""
    rng = np.random.default_rng(31)
    garment = make_garment(rng, nodes=11, pose_widths=(), deformer_widths=(160, 225, 130))
    for network in (garment.pose_layers, garment.deformer_layers):
        network[0][0][:] = 0
    evaluators = [NativeFrame([garment], instruction_set=level, precision="int8") for level in LEVELS[1:]]
    for evaluator in evaluators:
        frame(evaluator, garment, (garment.dof_rest, (0, 0, -1)))
    assert len({evaluator.corrections().tobytes() for evaluator in evaluators}) == 1


@pytest.mark.parametrize("level", LEVELS)
def test_int8_sums_do_not_overflow(level, make_garment):
    """Where every product of a long row is as large as can be, inputs are rounded more coarsely."""
    sizes = dict(bones=1, dofs=0, nodes=1, pose_widths=(), deformer_widths=(3000,))
    garment = make_garment(np.random.default_rng(23), **sizes)
    garment.pose_layers[0][0][:] = garment.pose_layers[0][1][:] = 0
    for (weight, bias), value in zip(garment.deformer_layers, (0, 1e-3)):
        weight[:], bias[:] = value, 40 if value == 0 else 0
    evaluator = NativeFrame([garment], instruction_set=level, precision="int8")
    frame(evaluator, garment, (np.empty(0, np.float32), (0, 0, -1)))
    np.testing.assert_allclose(evaluator.corrections(), 120.0, rtol=1e-4)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_overflow_is_not_swallowed(precision, level, make_garment, make_pose):
    """Infinities and NaN inside the networks reach the check, whatever rounds in between."""
    rng = np.random.default_rng(24)
    garment = make_garment(rng, deformer_widths=(12,) * 12)
    for weight, _ in garment.deformer_layers:
        weight *= np.float32(3e4)
    evaluator = NativeFrame([garment], instruction_set=level, precision=precision)
    out, (positions, gravity) = np.full((len(garment.vertices), 6), 7.0, np.float32), make_pose(rng, garment)
    with pytest.raises(ValueError, match="corrections of garment nodes"):
        evaluator.evaluate(positions, told(gravity)[None], [out])
    assert (out == 7.0).all() and not evaluator.node_transforms().any()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_nan_alone_is_not_swallowed(precision, level, make_garment):
    """A layer whose inputs are all NaN, none infinite: an infinite scale and an infinite shift have cancelled."""
    sizes = dict(dofs=0, pose_widths=(8,) * 9, deformer_widths=(8, 8))
    garment = make_garment(np.random.default_rng(30), **sizes)
    for weight, bias in garment.pose_layers[:-1]:
        weight[:], bias[:] = 1e6, 1e6
    garment.pose_layers[-1][0][:] = np.repeat([1, -1, 0, 0], 8)[:, None]  # of the first hidden layer alone
    garment.pose_layers[-1][1][:] = 0
    garment.deformer_layers[0][0][:], garment.deformer_layers[0][1][:] = 0, 1
    evaluator = NativeFrame([garment], instruction_set=level, precision=precision)
    with pytest.raises(ValueError, match=r"corrections of garment nodes\[0\] is -?nan"):
        frame(evaluator, garment, (np.empty(0, np.float32), (0, 0, 1)))


def test_environment_sets_the_default_precision(make_garment, monkeypatch):
    garment = make_garment(np.random.default_rng(25))
    monkeypatch.delenv("PHYSKIN_NATIVE_PRECISION", raising=False)
    assert NativeFrame([garment], precision=None).precision == "int8"
    monkeypatch.setenv("PHYSKIN_NATIVE_PRECISION", "fp32")
    assert NativeFrame([garment], precision=None).precision == "fp32"
    assert NativeFrame([garment], precision="int8").precision == "int8"
    monkeypatch.setenv("PHYSKIN_NATIVE_PRECISION", "fp8")
    with pytest.raises(ValueError, match=r"'fp8' \(from PHYSKIN_NATIVE_PRECISION\) is unknown"):
        NativeFrame([garment], precision=None)
    with pytest.raises(ValueError, match="'double' is unknown; it may be fp32, bf16 or int8"):
        NativeFrame([garment], precision="double")


# --- Steps with bound arrays; what they compute: test_draper.py ---


@pytest.fixture
def bound_step(make_garment, make_pose):
    """An evaluator, the arrays of a frame, and that bound to them."""
    rng = np.random.default_rng(27)
    garment = make_garment(rng)
    evaluator, (positions, gravity) = NativeFrame([garment]), make_pose(rng, garment)
    arrays = positions, told(gravity)[None], [np.zeros((len(garment.vertices), 6), dtype=np.float32)]
    return evaluator, arrays, evaluator.bind_frame(*arrays)


def test_step_allocates_no_python_object(bound_step):
    step = bound_step[-1].step
    step()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for _ in range(1000):
            step()
        current, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert current - before < 200 and peak - before < 200  # the loop's own counter and iterator


def test_step_keeps_its_arrays_alive(make_garment, make_pose):
    rng = np.random.default_rng(29)
    garment = make_garment(rng)
    pose = make_pose(rng, garment)
    expected = frame(NativeFrame([garment], precision=None), garment, pose)
    out = np.zeros_like(expected)
    view = memoryview(out)
    bound = NativeFrame([garment], precision=None).bind_frame(pose[0].copy(), told(pose[1])[None], [out])
    del out
    gc.collect()
    _ = [np.full(1000, np.nan) for _ in range(100)]
    bound.step()
    assert np.array_equal(np.asarray(view), expected)


@pytest.mark.parametrize(
    "change, error",
    [
        (lambda q, rows, out: (q.astype(np.float64), rows, [out]), TypeError),
        (lambda q, rows, out: (np.repeat(q, 2)[::2], rows, [out]), TypeError),
        (lambda q, rows, out: (q, rows.astype(np.float64), [out]), TypeError),
        (lambda q, rows, out: (q, rows, [out.astype(np.float64)]), TypeError),
        (lambda q, rows, out: (q[:-1].copy(), rows, [out]), ValueError),
        (lambda q, rows, out: (q, rows[:, :2].copy(), [out]), ValueError),
        (lambda q, rows, out: (q, rows, [out[:-1]]), ValueError),
        (lambda q, rows, out: (q, rows, [np.zeros((len(out), 12), np.float32)[:, ::2]]), ValueError),
    ],
)
def test_step_converts_nothing(change, error, bound_step):
    """An array that would need a copy is refused when it is bound."""
    evaluator, (positions, rows, (out,)), _ = bound_step
    with pytest.raises(error):
        evaluator.bind_frame(*change(positions, rows, out))
