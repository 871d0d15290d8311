"""Garment nodes that twist: the native evaluator against the NumPy reference, alone and in an outfit."""

from dataclasses import replace

import numpy as np
import pytest
from physkin_core.outfit.outfit_evaluators import NativeOutfitEvaluator, ReferenceOutfitEvaluator
from physkin_core.runtime.native_evaluator import NativeEvaluator, supported_instruction_sets
from physkin_core.runtime.reference_evaluator import ReferenceEvaluator
from physkin_core.sway.pace import UNTOLD


def told(gravity, twist):
    return np.append(gravity, [twist, UNTOLD]).astype(np.float32)


def drape(evaluator, garment, positions, gravity):
    out = np.empty((len(garment.vertices), 6), dtype=np.float32)
    evaluator.evaluate(positions, gravity, out)
    return out


@pytest.mark.parametrize("level", supported_instruction_sets())
@pytest.mark.parametrize("seed", range(6))
def test_native_and_reference_agree(seed, level, make_garment, make_pose):
    rng = np.random.default_rng(seed)
    garment = make_garment(rng)
    positions, gravity = make_pose(rng, garment)
    gravity = np.append(gravity, [rng.uniform(-1, 1), UNTOLD]).astype(np.float32)
    evaluator, reference = (
        NativeEvaluator(garment, instruction_set=level, precision="fp32"),
        ReferenceEvaluator(garment),
    )
    native, expected = (drape(each, garment, positions, gravity) for each in (evaluator, reference))
    assert np.abs(native - expected).max() < 2e-5
    stepped = np.empty_like(native)
    evaluator.bind_step(positions.astype(np.float32), gravity, stepped).step()
    assert (stepped == native).all()


def test_no_twist_is_bit_for_bit_the_drape_without(make_garment, make_pose):
    """And where a garment does not twist, any twist is."""
    rng = np.random.default_rng(9)
    garment = make_garment(rng)
    positions, gravity = make_pose(rng, garment)
    plain = drape(NativeEvaluator(garment), garment, positions, gravity)
    assert (drape(NativeEvaluator(garment), garment, positions, told(gravity, 0)) == plain).all()
    twisting = told(gravity, 0.4)
    still = replace(garment, node_twist=np.empty(0, dtype=np.float32))
    for backend in (NativeEvaluator, ReferenceEvaluator):
        assert np.abs(drape(backend(still), still, positions, twisting) - plain).max() < 0.01
    assert (drape(NativeEvaluator(still), still, positions, twisting) == plain).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_twist_that_is_not_finite_is_refused(bad, make_garment, make_pose):
    rng = np.random.default_rng(10)
    garment = make_garment(rng)
    positions, gravity = make_pose(rng, garment)
    for evaluator, name in ((NativeEvaluator(garment), "twist"), (ReferenceEvaluator(garment), "gravity")):
        with pytest.raises(ValueError, match=rf"{name}.* is {bad}.*finite"):
            drape(evaluator, garment, positions, told(gravity, bad))


def test_garments_of_an_outfit_twist_each_as_told(make_garment, make_pose):
    rng = np.random.default_rng(11)
    garment = make_garment(rng)
    positions, gravity = make_pose(rng, garment)
    positions = positions.astype(np.float32)
    gravities = np.stack([told(gravity, twist) for twist in (0.0, 0.5)])
    alone = [drape(NativeEvaluator(garment, precision="fp32"), garment, positions, each) for each in gravities]
    assert np.abs(alone[1] - alone[0]).max() > 0.01
    native = NativeOutfitEvaluator([garment] * 2, [], precision="fp32")
    for evaluator in (native, ReferenceOutfitEvaluator([garment] * 2, [])):
        outs = [np.empty_like(alone[0]) for _ in range(2)]
        evaluator.evaluate(positions, gravities, outs)
        assert max(np.abs(a - b).max() for a, b in zip(outs, alone)) < 2e-5
    for given in (gravities, np.ascontiguousarray(gravities[1])):
        native.bind_step(positions, given, outs).step()
        assert (outs[1] == alone[1]).all()
