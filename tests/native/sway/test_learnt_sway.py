"""Garment nodes that sway by a network: the native evaluator against the NumPy reference, alone and in an outfit."""

from dataclasses import replace

import numpy as np
import pytest
from physkin_core.outfit.outfit_evaluators import NativeOutfitEvaluator, ReferenceOutfitEvaluator
from physkin_core.runtime.native_evaluator import NativeEvaluator, supported_instruction_sets
from physkin_core.runtime.reference_evaluator import ReferenceEvaluator
from physkin_core.sway.moment import Moment
from physkin_core.sway.pace import UNTOLD

SIZES = [{}, {"dofs": 11, "nodes": 37, "vertices": 70, "activation": "relu"}]


def swaying(make_garment, rng, **sizes):
    return make_garment(rng, correction_size=12, learnt_sway=True, **sizes)


def drape(evaluator, garment, positions, told):
    out = np.empty((len(garment.vertices), 6), dtype=np.float32)
    evaluator.evaluate(positions, told, out)
    return out


def frames(rng, garment, make_pose, count):
    """Of anything: several rates, doubled stamps, gaps, jumps, resets, none told; cloth keeps no pace here."""
    positions, gravity = make_pose(rng, garment)
    for _ in range(count):
        positions = (positions + rng.normal(size=len(positions), scale=0.1)).astype(np.float32)
        positions = np.clip(positions, garment.dof_lower - 1, garment.dof_upper + 1)
        down = gravity + 0.1 * rng.normal(size=3)
        elapsed = rng.choice([1 / 120, 1 / 60, 1 / 15, 0.0, 0.4, 3.0, -1.0], p=[0.3, 0.3, 0.2, 0.1, 0.04, 0.04, 0.02])
        moment = Moment(
            twist=0.1 * rng.normal(),
            sway=rng.choice([1.0, 0.4, 0.0], p=[0.8, 0.15, 0.05]),
            elapsed=elapsed,
            moves=float(elapsed < 0.3 and rng.uniform() < 0.9),
            velocity=rng.normal(size=3),
            turning=rng.normal(size=3),
        )
        told = moment.after(down / np.linalg.norm(down))
        yield positions, told[:3] if rng.uniform() < 0.05 else told


@pytest.mark.parametrize("level", supported_instruction_sets())
@pytest.mark.parametrize("sizes", SIZES)
def test_native_and_reference_agree(level, sizes, make_garment, make_pose):
    rng = np.random.default_rng(5)
    garment = swaying(make_garment, rng, **sizes)
    native, reference = NativeEvaluator(garment, instruction_set=level, precision="fp32"), ReferenceEvaluator(garment)
    stepper = NativeEvaluator(garment, instruction_set=level, precision="fp32")
    swayed = 0.0
    for positions, told in frames(rng, garment, make_pose, 60):
        found, expected = (drape(each, garment, positions, told) for each in (native, reference))
        assert np.abs(found - expected)[:, :3].max() < 3e-5
        stepped = np.empty_like(found)
        stepper.bind_step(positions, told, stepped).step()
        assert (stepped == found).all()
        still = ReferenceEvaluator(garment)
        swayed = max(swayed, np.abs(expected - drape(still, garment, positions, told[:3]))[:, :3].max())
    assert swayed > 0.02


@pytest.mark.parametrize("precision", ["bf16", "int8"])
def test_rounded_network_weights_sway_alike(precision, make_garment, make_pose):
    rng = np.random.default_rng(6)
    garment = swaying(make_garment, rng)
    exact, rounded = (NativeEvaluator(garment, precision=each) for each in ("fp32", precision))
    offsets, errors = [], []
    for positions, told in frames(rng, garment, make_pose, 60):
        corrections = []
        for evaluator in (exact, rounded):
            drape(evaluator, garment, positions, told)
            with_sway = evaluator.corrections()
            drape(evaluator, garment, positions, told[:3])
            corrections.append(with_sway - evaluator.corrections())
        offsets.append(corrections[0])
        errors.append(corrections[1] - corrections[0])
    assert np.sqrt(np.square(errors).mean()) < 0.03 * np.sqrt(np.square(offsets).mean())


def test_where_nothing_sways_it_is_bit_for_bit_the_drape(make_garment, make_pose):
    rng = np.random.default_rng(7)
    garment = swaying(make_garment, rng)
    positions, gravity = make_pose(rng, garment)
    plain = drape(NativeEvaluator(garment), garment, positions, gravity)
    for told in (Moment(elapsed=0.1), Moment(sway=0.0, elapsed=UNTOLD)):
        assert (drape(NativeEvaluator(garment), garment, positions, told.after(gravity)) == plain).all()
    told = Moment(sway=1.0).after(gravity)
    evaluator = NativeEvaluator(garment)
    assert np.abs(drape(evaluator, garment, positions, told) - plain).max() > 1e-3
    assert (drape(evaluator, garment, positions, gravity) == plain).all()
    assert (drape(evaluator, garment, positions, np.append(gravity, [0, UNTOLD]).astype(np.float32)) == plain).all()


def test_a_frame_that_is_told_nothing_leaves_it_swinging(make_garment, make_pose):
    """One that is told not to sway does not."""
    rng = np.random.default_rng(8)
    garment = swaying(make_garment, rng)
    steps = list(frames(rng, garment, make_pose, 3))
    told = [Moment(sway=1.0, elapsed=e, moves=1.0).after(down[:3]) for e, (_, down) in zip((UNTOLD, 0.02, 0.02), steps)]
    ends = []
    for between in (None, told[1][:3], Moment().after(told[1][:3])):
        evaluator = NativeEvaluator(garment)
        for k, (positions, _) in enumerate(steps):
            if k == 2 and between is not None:
                drape(evaluator, garment, positions, between)
            cloud = drape(evaluator, garment, positions, told[k])
        ends.append(cloud)
    assert (ends[1] == ends[0]).all() and np.abs(ends[2] - ends[0]).max() > 1e-4


@pytest.mark.parametrize("index", range(5, 14))
@pytest.mark.parametrize("backend", [NativeEvaluator, ReferenceEvaluator])
def test_a_moment_that_is_not_finite_is_refused_and_changes_nothing(index, backend, make_garment, make_pose):
    rng = np.random.default_rng(9)
    garment = swaying(make_garment, rng)
    (positions, _), *_ = frames(rng, garment, make_pose, 1)
    told = Moment(sway=1.0, elapsed=0.02, moves=1.0).after((0, 0, -1))
    evaluator, other = backend(garment), backend(garment)
    drape(evaluator, garment, positions, told), drape(other, garment, positions, told)
    wrong = told.copy()
    wrong[index] = np.nan
    with pytest.raises(ValueError, match="is nan.*finite"):
        drape(evaluator, garment, positions, wrong)
    again = [drape(each, garment, 0.9 * positions, told) for each in (evaluator, other)]
    assert (again[0] == again[1]).all()


@pytest.mark.parametrize("backend", [NativeEvaluator, ReferenceEvaluator])
def test_after_networks_that_are_refused_it_begins_anew(backend, make_garment, make_pose):
    rng = np.random.default_rng(10)
    garment = swaying(make_garment, rng)
    (positions, _), *_ = frames(rng, garment, make_pose, 1)
    told = Moment(sway=1.0, elapsed=0.02, moves=1.0).after((0, 0, -1))
    evaluator = backend(garment)
    drape(evaluator, garment, 0.5 * positions, told)
    with pytest.raises(ValueError, match="finite"):
        drape(evaluator, garment, positions, np.concatenate([np.float32([0, 0, 3e38]), told[3:]]))
    found, fresh = (drape(each, garment, positions, told) for each in (evaluator, backend(garment)))
    assert np.isfinite(found).all() and np.abs(found - fresh).max() < 1e-6


@pytest.mark.parametrize("wrong", [(6,), (4,), (13,), (15,), (2, 14)])
def test_gravity_of_another_size_is_refused(wrong, make_garment, make_pose):
    rng = np.random.default_rng(11)
    garment = swaying(make_garment, rng)
    positions, _ = make_pose(rng, garment)
    for evaluator in (NativeEvaluator(garment), ReferenceEvaluator(garment)):
        with pytest.raises(ValueError, match="gravity must have shape"):
            drape(evaluator, garment, positions, np.zeros(wrong, np.float32))


def test_hours_of_anything_stay_finite(make_garment, make_pose):
    """Rates and joint positions of any size a float has."""
    rng = np.random.default_rng(12)
    garment = swaying(make_garment, rng)
    evaluator = NativeEvaluator(garment)
    for k, (positions, told) in enumerate(frames(rng, garment, make_pose, 20_000)):
        if k % 50 == 0 and len(told) > 3:
            told[6] = rng.choice([1e-45, 1e-30, 1e30])
            told[8:] = rng.choice([-3e38, 0, 3e38], size=6)
            positions = rng.choice(np.array([-3e38, 0, 3e38], np.float32), size=len(positions))
        assert np.isfinite(drape(evaluator, garment, positions, told)).all()


def test_garments_of_an_outfit_sway_each_as_told(make_garment, make_pose):
    rng = np.random.default_rng(13)
    garment = swaying(make_garment, rng)
    native = NativeOutfitEvaluator([garment] * 2, [], precision="fp32")
    reference = ReferenceOutfitEvaluator([garment] * 2, [])
    singles = [NativeEvaluator(garment, precision="fp32") for _ in range(2)]
    outs = [np.empty((len(garment.vertices), 6), dtype=np.float32) for _ in range(2)]
    for positions, told in frames(rng, garment, make_pose, 12):
        if len(told) == 3:
            continue
        both = np.stack([told, told])
        both[1, 5], both[1, :3] = 0.5, -both[1, :3]
        alone = [drape(each, garment, positions, row) for each, row in zip(singles, both)]
        for evaluator in (native, reference):
            evaluator.evaluate(positions, both, outs)
            assert max(np.abs(a - b)[:, :3].max() for a, b in zip(outs, alone)) < 3e-5
    assert np.abs(alone[0] - alone[1]).max() > 1e-3


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sway_layers": ()}, "without sway_layers"),
        ({"sway_rates": np.zeros(10, np.float32)}, r"sway_rates\[0\] is 0.0+; must be above 0"),
        ({"sway_turns": np.zeros(9, np.float32)}, "sway_turns must be"),
        ({"sway_joints": np.array([0, 1, 2, 7], np.int32)}, r"sway_joints\[3\] is 7; must be in \[0, 7\)"),
        ({"sway_joints": np.arange(3, dtype=np.int32)}, r"sway_layers of the drive\[0\] has 23 inputs; expected 21"),
    ],
)
def test_bound_garments_that_do_not_fit_are_refused(changes, said, make_garment):
    garment = swaying(make_garment, np.random.default_rng(14))
    with pytest.raises(ValueError, match=said):
        NativeEvaluator(replace(garment, **changes))


def test_layers_that_do_not_fit_are_refused(make_garment):
    garment = swaying(make_garment, np.random.default_rng(15))
    first, driven, read, last, out = garment.sway_layers
    for layers, said in (
        ((first, driven, read, last), "sway_layers are 4; expected none or 5"),
        ((first, tuple(each[:-1] for each in driven), read, last, out), "gives 29 values; expected 3 for each"),
        ((first, driven, read, last, tuple(each[:-1] for each in out)), "give 71 and 72 values; expected 12"),
    ):
        with pytest.raises(ValueError, match=said):
            NativeEvaluator(replace(garment, sway_layers=layers))
