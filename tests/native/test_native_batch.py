"""Frames of several bodies from one set of network weights, against the same bodies one by one."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from random_models import random_avatar, random_model, random_pose

from physkin_core.runtime import binding
from physkin_core.runtime.binding import bind_garment
from physkin_core.runtime.native_evaluator import (
    PRECISIONS,
    NativeEvaluator,
    NativeEvaluatorBatch,
    supported_instruction_sets,
)
from physkin_core.runtime.reference_evaluator import ReferenceEvaluator

LEVELS = supported_instruction_sets()
SHAPES = {
    "small": dict(),
    "odd widths": dict(pose_widths=(37, 19, 65), deformer_widths=(33, 7, 50)),
    "wide": dict(pose_widths=(160, 300), deformer_widths=(224, 130)),
}


@pytest.fixture(autouse=True)
def few_body_points(monkeypatch):
    monkeypatch.setattr(binding, "POINT_COUNT", 50)


def bodies(seed, count, **sizes):
    """A model, its bound garments on `count` bodies with the modulation not folded in, joint positions and gravity."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, **sizes)
    bounds = [bind_garment(model, random_avatar(rng, model.rig), fold=False) for _ in range(count)]
    poses, gravity = zip(*(random_pose(rng, model.rig) for _ in bounds))
    return model, bounds, np.array(poses), np.array(gravity)


def one_by_one(bounds, poses, gravity, **options):
    out = np.empty((len(bounds), len(bounds[0].vertices), 6), dtype=np.float32)
    for k, bound in enumerate(bounds):
        NativeEvaluator(bound, **options).evaluate(poses[k], gravity[k], out[k])
    return out


@pytest.mark.parametrize("shape", SHAPES)
def test_a_batch_gives_the_bits_of_single_frames(shape):
    """Of any size, more than are computed at once and less."""
    _, bounds, poses, gravity = bodies([60, len(shape)], 9, **SHAPES[shape])
    for precision, level, count in product(PRECISIONS, LEVELS, (1, 2, 3, 4, 9)):
        if count == 1:
            expected = one_by_one(bounds, poses, gravity, precision=precision, instruction_set=level)
            assert np.abs(expected[0] - expected[1]).max() > 1e-3  # bodies and poses differ
        batch = NativeEvaluatorBatch(bounds[:count], precision=precision, instruction_set=level)
        assert (batch.precision, batch.instruction_set) == (precision, level)
        out = np.full((count, *expected.shape[1:]), np.nan, dtype=np.float32)
        batch.evaluate(poses[:count], gravity[:count], out)
        assert np.array_equal(out, expected[:count])


def test_an_unfolded_body_is_the_folded_one():
    """Modulation applied or folded in: the same frame but for rounding, in C++ and in the reference."""
    rng = np.random.default_rng(61)
    model = random_model(rng)
    avatar, (pose, gravity) = random_avatar(rng, model.rig), random_pose(rng, model.rig)
    frames = []
    for fold in (True, False):
        bound = bind_garment(model, avatar, fold=fold)
        assert len(bound.pose_modulation) == (0 if fold else 64)
        for evaluator in (NativeEvaluator(bound, precision="fp32"), ReferenceEvaluator(bound)):
            frames.append(np.empty((len(bound.vertices), 6), dtype=np.float32))
            evaluator.evaluate(pose, gravity, frames[-1])
    assert all(np.abs(frame - frames[0]).max() < 2e-5 for frame in frames[1:])


def test_rows_may_lie_in_any_order():
    """Bodies in turns, backwards, positions alone; only the addressed numbers are written."""
    _, bounds, poses, gravity = bodies(62, 3)
    expected = one_by_one(bounds, poses, gravity)
    batch = NativeEvaluatorBatch(bounds)
    n = len(bounds[0].vertices)
    for view in (
        lambda a: a.reshape(3, n, 8)[:, :, :6],
        lambda a: a.reshape(3, n, 8)[::-1, ::-1, :6],
        lambda a: a.reshape(n, 3, 8).transpose(1, 0, 2)[:, :, :6],
        lambda a: a.reshape(3, n, 8)[:, :, 2:5],
    ):
        buffer = np.full(3 * n * 8, 7, dtype=np.float32)
        out = view(buffer)
        batch.evaluate(poses, gravity, out)
        assert np.array_equal(out, expected[:, :, : out.shape[2]])
        assert (buffer == 7).sum() == buffer.size - out.size


def test_what_is_not_finite_is_refused_by_body():
    """Nothing is written for any body."""
    _, bounds, poses, gravity = bodies(63, 6)
    batch = NativeEvaluatorBatch(bounds)
    out = np.full((6, len(bounds[0].vertices), 6), 7, dtype=np.float32)
    batch.bind(poses, gravity, out)
    poses[4, 2] = np.nan
    with pytest.raises(ValueError, match=r"body 4: joint_positions\[2\] is nan"):
        batch.step()
    poses[4, 2], gravity[5, 1] = 0, np.inf
    with pytest.raises(ValueError, match=r"body 5: gravity\[1\] is inf"):
        batch.step()
    assert (out == 7).all()
    gravity[5, 1] = 0
    batch.step()
    assert np.isfinite(out).all() and not (out == 7).any()


def test_networks_that_overflow_on_one_body_are_refused():
    _, bounds, poses, gravity = bodies(64, 3)
    huge = bounds[1].pose_modulation.copy()
    huge[:] = 1e6
    first, *rest = bounds[1].deformer_layers
    broken = replace(bounds[1], pose_modulation=huge, deformer_layers=((first[0] * np.float32(1e5), first[1]), *rest))
    batch = NativeEvaluatorBatch([bounds[0], broken, bounds[2]])
    out = np.full((3, len(bounds[0].vertices), 6), 7, dtype=np.float32)
    with pytest.raises(ValueError, match="body 1: node deformer output"):
        batch.evaluate(poses, gravity, out)
    assert (out == 7).all()


def test_bodies_of_other_models_are_refused():
    """Folded ones too: their network weights are their own."""
    model, bounds, *_ = bodies(65, 2)
    _, others, *_ = bodies(66, 1)
    rng = np.random.default_rng(67)
    folded = [bind_garment(model, random_avatar(rng, model.rig)) for _ in range(2)]
    for mixed in ([*bounds, others[0]], folded, [bounds[0], folded[0]]):
        with pytest.raises(ValueError, match="other networks than the first"):
            NativeEvaluatorBatch(mixed)
    with pytest.raises(ValueError, match="at least one bound garment"):
        NativeEvaluatorBatch([])
    with pytest.raises(ValueError, match="pose_modulation has 3 values"):
        NativeEvaluator(replace(bounds[0], pose_modulation=np.zeros(3, np.float32)))


@pytest.mark.parametrize(
    "change, error",
    [
        (lambda q, g, out: (q.astype(np.float64), g, out), TypeError),
        (lambda q, g, out: (np.repeat(q, 2, axis=1)[:, ::2], g, out), TypeError),
        (lambda q, g, out: (q, g, out.astype(np.float64)), TypeError),
        (lambda q, g, out: (q, g, np.lib.stride_tricks.as_strided(out, writeable=False)), TypeError),
        (lambda q, g, out: (q[:2].copy(), g, out), ValueError),
        (lambda q, g, out: (q, g[:, :2].copy(), out), ValueError),
        (lambda q, g, out: (q, g, out[:2]), ValueError),
        (lambda q, g, out: (q, g, out[:, 1:]), ValueError),
        (lambda q, g, out: (q, g, out[:, :, :5]), ValueError),
        (lambda q, g, out: (q, g, np.lib.stride_tricks.as_strided(out, strides=(4, *out.strides[1:]))), ValueError),
        (lambda q, g, out: (q, g, np.lib.stride_tricks.as_strided(out, strides=(0, *out.strides[1:]))), ValueError),
    ],
)
def test_other_arrays_are_refused(change, error):
    """Wrong dtype, stride or shape, read-only, or bodies on top of each other."""
    _, bounds, poses, gravity = bodies(68, 3)
    batch = NativeEvaluatorBatch(bounds)
    with pytest.raises(ValueError, match="bind them first"):
        batch.step()
    out = np.zeros((3, len(bounds[0].vertices), 6), dtype=np.float32)
    with pytest.raises(error):
        batch.bind(*change(poses, gravity, out))
