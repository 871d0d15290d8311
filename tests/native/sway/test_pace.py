"""Garment nodes that keep their pace: the native evaluator against the NumPy reference, alone and in an outfit."""

import numpy as np
import pytest
from physkin_core.outfit.outfit_evaluators import NativeOutfitEvaluator, ReferenceOutfitEvaluator
from physkin_core.runtime.native_evaluator import NativeEvaluator
from physkin_core.runtime.reference_evaluator import ReferenceEvaluator
from physkin_core.sway.pace import UNTOLD


def frames(rng, garment, make_pose, count=12):
    """Poses of a motion, each less than the jump of a joint from the last one, and gravity, alike in all."""
    positions, gravity = make_pose(rng, garment)
    steps = rng.uniform(-0.3, 0.3, size=(count, len(positions)))
    return (positions + np.cumsum(steps, axis=0)).astype(np.float32), gravity


def drapes(evaluator, garment, positions, gravity, passed):
    out = []
    for pose, seconds in zip(positions, passed):
        out.append(np.empty((len(garment.vertices), 6), dtype=np.float32))
        moment = () if seconds is None else (0.0, seconds)
        evaluator.evaluate(pose, np.append(gravity, moment).astype(np.float32), out[-1])
    return np.stack(out)


@pytest.mark.parametrize("seed", range(6))
def test_native_and_reference_agree(seed, make_garment, make_pose):
    rng = np.random.default_rng(seed)
    garment = make_garment(rng, correction_size=(9, 12)[seed % 2])
    positions, gravity = frames(rng, garment, make_pose)
    passed = [UNTOLD, *rng.choice([0.0, 1e-3, 5e-3, 1 / 60, UNTOLD], size=len(positions) - 1)]
    given = (garment, positions, gravity)
    native = drapes(NativeEvaluator(garment, precision="fp32"), *given, passed)
    plain = drapes(NativeEvaluator(garment, precision="fp32"), *given, [None] * len(passed))
    assert np.abs(native - drapes(ReferenceEvaluator(garment), *given, passed)).max() < 5e-5
    late = np.abs(native - plain).max(axis=(1, 2))
    assert late.max() > 0.01, "nothing was kept back"
    assert (late[np.equal(passed, UNTOLD)] == 0).all()
    outs = [np.empty_like(native[0]) for _ in range(2)]
    for outfit in (
        NativeOutfitEvaluator([garment] * 2, [], precision="fp32"),
        ReferenceOutfitEvaluator([garment] * 2, []),
    ):
        for k, (pose, seconds) in enumerate(zip(positions, passed)):
            outfit.evaluate(pose, np.append(gravity, (0.0, seconds)).astype(np.float32), outs)
            assert max(np.abs(out - native[k]).max() for out in outs) < 5e-5


def test_after_a_jump_of_a_joint_the_pose_is_draped_as_it_is(make_garment, make_pose):
    rng = np.random.default_rng(20)
    garment = make_garment(rng)
    positions, gravity = frames(rng, garment, make_pose, count=2)
    positions[1, 0] = positions[0, 0] + 0.6
    for evaluator in (NativeEvaluator(garment), ReferenceEvaluator(garment)):
        plain = drapes(evaluator, garment, positions, gravity, [None, None])
        assert (drapes(evaluator, garment, positions, gravity, [UNTOLD, 1e-3]) == plain).all()


def test_a_time_that_is_not_finite_is_refused_and_what_is_refused_does_not_count(make_garment, make_pose):
    rng = np.random.default_rng(21)
    garment = make_garment(rng)
    positions, gravity = frames(rng, garment, make_pose, count=3)
    for make in (NativeEvaluator, ReferenceEvaluator):
        evaluator = make(garment)
        whole = drapes(make(garment), garment, positions[[0, 2]], gravity, [UNTOLD, 1e-3])
        first = drapes(evaluator, garment, positions[:1], gravity, [UNTOLD])
        with pytest.raises(ValueError, match=r"finite"):
            drapes(evaluator, garment, positions[1:2], gravity, [np.nan])
        assert (np.concatenate([first, drapes(evaluator, garment, positions[2:], gravity, [1e-3])]) == whole).all()


def test_after_networks_that_are_refused_the_pose_is_draped_as_it_is(make_garment, make_pose):
    rng = np.random.default_rng(22)
    garment = make_garment(rng)
    positions, gravity = frames(rng, garment, make_pose, count=2)
    for make in (NativeEvaluator, ReferenceEvaluator):
        plain = drapes(make(garment), garment, positions[1:], gravity, [None])
        evaluator = make(garment)
        drapes(evaluator, garment, positions[:1], gravity, [UNTOLD])
        with pytest.raises(ValueError, match="node deformer output"):
            drapes(evaluator, garment, positions[:1], 1e30 * gravity, [1e-3])
        assert (drapes(evaluator, garment, positions[1:], gravity, [1e-3]) == plain).all()


def test_a_joint_that_was_no_number_has_jumped(make_garment, make_pose):
    """In an outfit, which poses its bones before it looks."""
    rng = np.random.default_rng(23)
    garment = make_garment(rng)
    positions, gravity = frames(rng, garment, make_pose, count=1)
    far = positions[0] + np.float32(1.0)
    moment = np.append(gravity, (0.0, 1e-3)).astype(np.float32)
    plain, out = (np.empty((len(garment.vertices), 6), dtype=np.float32) for _ in range(2))
    NativeOutfitEvaluator([garment], []).evaluate(far, gravity, [plain])
    outfit = NativeOutfitEvaluator([garment], [])
    outfit.evaluate(positions[0], moment, [out])
    with pytest.raises(ValueError, match="finite"):
        outfit.evaluate(positions[0] * np.float32(np.nan), moment, [out])
    outfit.evaluate(far, moment, [out])
    assert (out == plain).all()
