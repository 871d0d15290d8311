"""The limb separator against the reference, and what it refuses."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from reference.limb_separator import ReferenceLimbSeparator

from physkin_core import DegreeOfFreedom, Rig, avatar_from_body, load_body_model
from physkin_core.runtime.evaluator import supported_instruction_sets
from physkin_core.separation.collision_shape import fit_collision_shape
from physkin_core.separation.limb_separator import SeparationSettings

SETTINGS, LEVELS = SeparationSettings(), supported_instruction_sets()


def native(shape, instruction_set=None):
    from physkin_core import _native

    return _native.LimbSeparator(shape, *astuple(SETTINGS), instruction_set)


@pytest.fixture(scope="module")
def shape():
    model = load_body_model()
    return fit_collision_shape(avatar_from_body(model, model.held_out_bodies[55]), model.rig, onset=SETTINGS.onset)[0]


def poses_in_contact(rig, rng, count):
    """Poses from anywhere within the limits, but for the arms, which hang close to the body."""
    poses = rng.uniform(rig.lower, rig.upper, (count, len(rig.dofs))).astype(np.float32)
    for name, down in (("upperarm01.L_x", -0.7), ("upperarm01.R_x", 0.7)):
        poses[:, rig.joint_names.index(name)] = down
    return poses


def test_equals_the_reference(shape):
    """To single precision, on every instruction set, in poses of many contacts."""
    reference, separators = ReferenceLimbSeparator(shape, SETTINGS), [native(shape, each) for each in LEVELS]
    found, changes = np.empty(len(shape.dof_bone), dtype=np.float32), []
    for pose in poses_in_contact(load_body_model().rig, np.random.default_rng(2), 25):
        expected, change = reference.separate(pose)
        for separator in separators:
            assert separator.separate(pose, found) == pytest.approx(change, abs=2e-4)
            np.testing.assert_allclose(found, expected, atol=2e-4)
        changes.append(change)
    assert np.median(changes) > 0.05


def test_equals_the_reference_on_another_rig():
    """128 bones in another order of joints, about axes of their own, with rests that are not zero."""
    model, rng = load_body_model(), np.random.default_rng(4)
    avatar, rig = avatar_from_body(model, model.held_out_bodies[10]), model.rig
    spare = 128 - rig.bone_count
    spots = rng.normal(size=(spare, 3)) * 0.1
    turned = [
        DegreeOfFreedom(
            dof.name,
            dof.bone,
            tuple(np.array(dof.axis) + 0.2 * rng.normal(size=3)),
            dof.lower - 0.1,
            dof.upper + 0.2,
            0.05,
        )
        for dof in rig.dofs
    ]
    other = Rig(
        bone_names=(*rig.bone_names, *(f"spare{k}" for k in range(spare))),
        parents=np.concatenate([rig.parents, rng.integers(0, rig.bone_count, spare)]),
        heads=np.concatenate([rig.heads, spots]),
        tails=np.concatenate([rig.tails, spots + 0.1]),
        dofs=tuple(turned[k] for k in rng.permutation(len(turned))),
    )
    heads = np.concatenate([avatar.bone_heads, spots]).astype(np.float32)
    bound = replace(avatar, bone_heads=heads, bone_tails=heads, bone_names=other.bone_names)
    shape, warnings = fit_collision_shape(bound, other, onset=SETTINGS.onset)
    assert not warnings
    reference, fast = ReferenceLimbSeparator(shape, SETTINGS), native(shape)
    found = np.empty(len(other.dofs), dtype=np.float32)
    for pose in poses_in_contact(other, rng, 6):
        expected, _ = reference.separate(pose)
        fast.separate(pose, found)
        np.testing.assert_allclose(found, expected, atol=2e-4)


def test_in_place(shape):
    """The array that comes in may be the one that goes out."""
    pose = poses_in_contact(load_body_model().rig, np.random.default_rng(3), 1)[0]
    out = np.empty_like(pose)
    separator = native(shape)
    separator.separate(pose, out)
    separator.separate(pose, pose)
    np.testing.assert_array_equal(pose, out)


@pytest.mark.parametrize(
    "field, change, message",
    [
        ("sphere_bone", lambda a: a + 100, "sphere_bone has 1.*; allowed: 0 to 35"),
        ("capsules", lambda a: a - 1, "capsules has -1"),
        ("allowed", lambda a: a[:-1], "allowed: one a contact"),
        ("trunk_frame", lambda a: a * 0, "trunk_frame: x, y, low, high"),
        ("heads", lambda a: a * np.float32(np.nan), "every value must be finite"),
        ("limb_start", lambda a: a * 0, "limb_start must lead into limb_dofs"),
        ("limb_dofs", lambda a: a * 0 + 500, "limb_dofs has 500"),
        ("pairs", lambda a: a + 400, "a pair names none there is"),
        ("parents", lambda a: a[::-1].copy(), "a parent must come before its child"),
        ("sphere_radius", lambda a: a.astype(np.float64), "sphere_radius must be a C-contiguous float32 array"),
    ],
)
def test_a_damaged_shape_is_refused(shape, field, change, message):
    """Indices, sizes and values are checked before anything is read by them."""
    with pytest.raises(ValueError, match=message):
        native(replace(shape, **{field: change(getattr(shape, field))}))


def test_bad_positions_are_refused(shape):
    """Not finite, too large, another size or kind."""
    separator, count = native(shape), len(shape.dof_bone)
    pose, out = np.zeros(count, dtype=np.float32), np.full(count, 3, dtype=np.float32)
    for value in (np.nan, np.inf, 1e9):
        pose[1] = value
        with pytest.raises(ValueError, match=r"joint_positions\[1\] is"):
            separator.separate(pose, out)
    assert (out == 3).all()
    with pytest.raises(ValueError, match="must have shape"):
        separator.separate(pose[:-1].copy(), out)
    with pytest.raises(TypeError):
        separator.separate(pose, out.astype(np.float64))
